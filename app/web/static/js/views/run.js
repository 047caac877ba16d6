/* Step 4: the machine moves; numbers, the path, pause and resume. Or: a Run is analysed. */
import { h, icon, mark, write } from "../dom.js";
import { hasEnded, isActive, isComputing, isMeasuring, isMoving } from "../flow.js";
import { holdToConfirm } from "../hold.js";
import { card, errorNotice, head, kindOf, notice, tile, wordOf } from "../parts.js";
import { drawStrip } from "../plots/strip-chart.js";
import { duration, known, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";
import { pathCard } from "./path-card.js";

const STAGES = {
  measure: ["planning", "measuring", "aligning", "estimating", "reporting"],
  analyse: ["aligning", "estimating", "reporting"],
};

/** Button that leads on. */
export function lead({ job, link }, { actions, go }) {
  if (!job) return { next: null };
  if (job.state === "succeeded") {
    return { next: { key: "result", label: t("run.next"), run: () => go(`#/result/${job.id}`) } };
  }
  if (hasEnded(job)) {
    return { next: { key: "again", label: t("run.again"), run: () => go("#/plan") } };
  }
  const cancel = isMeasuring(job) ? null : { label: t("run.cancel"), run: actions.abort };
  const wait = t(isMeasuring(job) ? "run.wait" : "run.wait_analysis");
  return { back: cancel, reason: link.stale ? t("run.stale") : wait,
    next: { key: "result", label: t("run.next"), disabled: true } };
}

/** Show the job under way. */
export function mount(root, context) {
  const { job } = context.store.get();
  const measuring = job ? isMeasuring(job) : true;
  return measuring ? mountMeasuring(root, context) : mountAnalysis(root);
}

function mountMeasuring(root, { actions }) {
  const path = pathCard(true);
  const progress = progressCard(STAGES.measure);
  const position = positionCard();
  const strip = h("div", { class: "strip" });
  const health = healthCard(strip);
  const buttons = motionButtons(actions);
  const ending = h("div");
  root.append(
    h("h1", { class: "unseen" }, t("run.title")), ending,
    h("div", { class: "columns is-main-left is-run" },
      h("div", { class: "stack" }, path.element, health.element),
      h("div", { class: "stack" }, progress.element, buttons.element, position.element)),
  );
  const chart = drawStrip(strip);
  let live = null;
  let ended = "";
  return {
    update(state) {
      const { job, plan, machine, link } = state;
      if (!job) return;
      path.update(plan, machine);
      progress.update(state);
      position.update(state);
      health.update(state);
      buttons.update(state);
      path.progress(reached(state), positionOf(state));
      const stale = isActive(job) && link.stale;
      for (const element of [progress.element, position.element, health.element, path.element]) {
        element.classList.toggle("is-stale-data", stale);
      }
      if (state.live && state.live !== live) {
        live = state.live;
        addSamples(chart, live);
      }
      const key = [job.id, job.state, job.error?.detail].join();
      if (ended !== key) {
        ended = key;
        ending.replaceChildren(...endingOf(job));
      }
    },
    close() {
      path.close();
      chart.close();
    },
  };
}

function mountAnalysis(root) {
  const progress = progressCard(STAGES.analyse);
  const ending = h("div");
  root.append(head(t("run.analysis_title"), t("run.analysis_text")), ending, progress.element);
  let ended = "";
  return {
    update(state) {
      if (!state.job) return;
      progress.update(state);
      if (ended === state.job.state) return;
      ended = state.job.state;
      ending.replaceChildren(...endingOf(state.job));
    },
    close() {},
  };
}

/** Rows of the plan that the machine has reached. */
function reached({ job, plan }) {
  if (!plan) return 0;
  if (isComputing(job) || job.state === "succeeded") return plan.position.length;
  const { done, total } = job.progress ?? {};
  return total ? Math.floor((done / total) * (plan.position.length - 1)) + 1 : 0;
}

/** Axis positions now: of the live stream, else as last kept with the job. */
function positionOf({ job, live }) {
  return live?.axes ?? (job.progress?.position?.length ? job.progress.position : null);
}

/** Blocks carry no time of single samples; they are spread over the time since the last. */
function addSamples(chart, live) {
  const points = live.tracker_mm ?? [];
  const end_s = live.device_time_s ?? 0;
  const step_s = 0.1 / Math.max(1, points.length);
  points.forEach((point, i) => chart.add(end_s - (points.length - 1 - i) * step_s, point));
}

function progressCard(stages) {
  const list = h("ol", { class: "stages", "aria-label": t("run.stages") });
  const entries = new Map(stages.map((stage) => [stage, h("li", {}, t(`stage.${stage}`))]));
  list.append(...entries.values());
  const percent = h("strong", {}, "–");
  const remaining = h("b", {}, "–");
  const bar = h("i");
  const meter = h("div", { class: "meter", role: "progressbar", "aria-valuemin": 0, "aria-valuemax": 100,
    "aria-label": t("run.progress") }, bar);
  const count = h("span", { class: "quiet number" });
  const uncertainty = h("span", { class: "number", id: "uncertainty" });
  const element = card(null, list,
    h("div", { class: "big-progress" }, percent,
      h("span", {}, h("span", { class: "quiet" }, t("run.remaining")), h("br"), remaining)),
    meter, h("p", { class: "beside" }, count, uncertainty));
  element.style.display = "grid";
  return { element, update };

  function update({ job, estimate }) {
    const now = job.progress ?? {};
    const stage = hasEnded(job) ? null : job.stage;
    markStages(job, stage);
    const share = job.state === "succeeded" ? 1 : now.total ? Math.min(1, now.done / now.total) : null;
    percent.replaceChildren(number(share === null ? null : Math.floor(100 * share)),
      h("span", { class: "unit" }, "%"));
    bar.style.transform = share === null ? "" : `scaleX(${share})`;
    meter.classList.toggle("is-waiting", share === null && isActive(job));
    meter.classList.toggle("is-held", ["pausing", "paused", "aborting"].includes(job.state));
    mark(meter, "aria-valuenow", share === null ? null : Math.floor(100 * share));
    write(remaining, isActive(job) ? duration(now.eta_s) : "–");
    write(count, now.unit && now.total && isActive(job)
      ? t("run.count", { done: number(now.done), total: number(now.total),
        unit: known(`unit.${now.unit}`, now.unit ?? "") }) : "");
    const sigma = isActive(job) ? estimate?.volumetric_uncertainty_um : null;
    write(uncertainty, sigma ? t("run.uncertainty", { value: quantity(2 * sigma, "error") }) : "");
  }

  function markStages(job, stage) {
    const at = job.state === "succeeded" ? stages.length : stages.indexOf(stage);
    [...entries.values()].forEach((entry, i) => {
      mark(entry, "data-done", i < at ? "" : null);
      mark(entry, "aria-current", i === at ? "step" : null);
    });
  }
}

function positionCard() {
  const list = h("ul", { class: "readout", "aria-label": t("run.position") });
  const element = card(t("run.position"), list);
  let names = "";
  let outputs = [];
  return { element, update };

  function update(state) {
    const { plan, machine } = state;
    const position = positionOf(state);
    const axes = plan?.axes ?? Object.keys(machine?.axes ?? {});
    if (names !== axes.join()) build(axes, machine);
    outputs.forEach(({ output, kind }, i) => write(output, figure(position?.[i], kind)));
  }

  function build(axes, machine) {
    names = axes.join();
    outputs = axes.map((name) => ({
      name, kind: machine?.axes?.[name]?.type === "rotary" ? "turn" : "length",
      output: h("output", {}, "–"),
    }));
    list.replaceChildren(...outputs.map(({ name, kind, output }) =>
      h("li", {}, h("b", {}, name), output, h("span", { class: "unit" }, unitOf(kind)))));
  }
}

function healthCard(strip) {
  const samples = tile(t("run.samples"));
  const lost = tile(t("run.lost"));
  const crc = tile(t("run.crc"));
  const element = h("section", { class: "card stream" }, h("h2", {}, t("run.health")),
    h("p", { class: "stream-name quiet" }, t("run.signal", { unit: unitOf("length") }), key()),
    h("dl", { class: "tiles" }, samples.element, lost.element, crc.element), strip);
  return {
    element,
    update({ job }) {
      const now = job.health ?? {};
      write(samples.number, number(now.samples));
      write(lost.number, number(now.lost_samples));
      write(crc.number, number(now.crc_errors));
      mark(lost.element, "data-tone", now.lost_samples > 0 ? "fault" : null);
      mark(crc.element, "data-tone", now.crc_errors > 0 ? "fault" : null);
    },
  };
}

/** Pause at a touch, resume held: absolute verbs on two buttons, never a toggle. */
function motionButtons(actions) {
  const pause = h("button", { class: "button", type: "button", id: "pause", onclick: actions.pause },
    icon("pause"), t("run.pause"));
  const resume = h("button", { class: "button", type: "button", id: "resume" },
    icon("play"), t("run.resume"));
  holdToConfirm(resume, actions.resume);
  const element = h("div", { class: "motion-buttons" }, pause, resume);
  return {
    element,
    update({ job, link }) {
      element.hidden = !isMoving(job);
      pause.disabled = !["running", "resuming"].includes(job.state);
      resume.disabled = job.state !== "paused" || link.stale;
    },
  };
}

function key() {
  const entry = (name) => h("span", {}, h("i", { style: `border-color: var(--trace-${name.toLowerCase()})` }), name);
  return h("span", { class: "key" }, ["X", "Y", "Z"].map(entry));
}

function endingOf(job) {
  if (!hasEnded(job)) return job.error ? [below(errorNotice(job, "held"))] : [];
  if (job.state === "succeeded") return [];
  const kept = isMeasuring(job) && job.run_id ? t("run.kept") : "";
  const said = errorNotice(job) ?? notice("fault", wordOf(job.state), t("run.ended", { kind: kindOf(job.kind) }), kept);
  return [below(said)];
}

const below = (said) => h("div", { style: "margin-bottom: 20px" }, said);
