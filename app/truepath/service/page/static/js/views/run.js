/* Step 4: the machine moves; path, tables, numbers, pause and resume. Or: a Run is analysed. */
import { h, icon, write } from "../dom.js";
import {
  addressOf, hasEnded, isActive, isComputing, isDiscovery, isExtra, isMeasuring, isMoving, isTrend, isVerification, rowsNow,
} from "../flow.js";
import { holdToConfirm } from "../hold.js";
import { card, earlyEndNotice, errorNotice, head, kindOf, markStale, notice, segments, wordOf } from "../parts.js";
import { known, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";
import { estimateCard } from "./estimate-card.js";
import { healthCard } from "./health-card.js";
import { pathCard } from "./path-card.js";
import { progressCard } from "./progress-card.js";
import { verdictNotice } from "./verdict-band.js";

const RESUMABLE = new Set(["measure-otf", "measure-standstill", "measure-extra"]);
const STAGES = {
  measure: ["planning", "measuring", "aligning", "estimating", "reporting"],
  analyse: ["aligning", "estimating", "reporting"],
  discover: ["discovering", "reporting"],
  extra: ["planning", "measuring", "discovering", "reporting"],
  verify: ["planning", "measuring", "aligning", "reporting"],
  trend: ["estimating", "following", "reporting"],
  validate: ["aligning", "estimating", "validating", "reporting"],
};

let looksAt = "path";

/** Button that leads on. */
export function lead({ job, plan, link }, { actions, go }) {
  if (!job) return { next: null };
  if (job.state === "succeeded") {
    return { next: { key: "result", label: nextOf(job), run: () => go(addressOf(job)) } };
  }
  if (hasEnded(job)) {
    return mayGoOn(job) ? { next: acknowledgement(actions), back: goOn(job, actions) ?? again(job, plan, go) }
      : { next: again(job, plan, go), back: goOn(job, actions) };
  }
  const cancel = isMeasuring(job) ? null : { label: t("run.cancel"), run: actions.cancel };
  const wait = t(isMeasuring(job) ? "run.wait" : "run.wait_analysis");
  return { back: cancel, reason: link.stale ? t("run.stale") : wait,
    next: { key: "result", label: nextOf(job), disabled: true } };
}

/** Stations that are left can still be measured; nothing that is recorded is lost. */
const goOn = (job, actions) => (job.station ? { label: t("station.continue"),
  run: () => actions.prepare({ kind: job.kind, continues: job.id }) } : null);

/** Leads back to Check: what goes on is armed anew. */
const acknowledgement = (actions) => ({ key: "acknowledge", label: t("goon.prepare"), run: actions.acknowledge });

/** Extra lines go back to the discovery that asks for them. */
export const again = (job, plan, go) => (isExtra(job) && plan?.discovery_id
  ? { key: "asked", label: t("run.asked"), run: () => go(`#/discover/${plan.discovery_id}`) }
  : { key: "again", label: t("run.again"), run: () => go("#/plan") });

const nextOf = (job) => t(isDiscovery(job) ? "run.next_discovery" : isVerification(job) ? "run.next_verification" : "run.next");

/** Stages, title and text of a job that moves nothing. */
function computing(job) {
  if (isTrend(job)) return [STAGES.trend, t("run.trend_title"), t("run.trend_text")];
  if (isDiscovery(job)) return [STAGES.discover, t("run.discovery_title"), t("run.discovery_text")];
  const stages = job.monte_carlo ? STAGES.validate : STAGES.analyse;
  return [stages, t("run.analysis_title"), t("run.analysis_text")];
}

const stagesOf = (job) => (isVerification(job) ? STAGES.verify : isExtra(job) ? STAGES.extra : STAGES.measure);

/** Show the job under way. */
export function mount(root, context) {
  const { job } = context.store.get();
  const measuring = job ? isMeasuring(job) : true;
  return measuring ? mountMeasuring(root, context, job) : mountAnalysis(root, job);
}

/** A machine that moves; extra lines and points of a verification have no tables of their own. */
function mountMeasuring(root, { store, actions }, job) {
  const extra = isExtra(job) || isVerification(job);
  const path = pathCard(true);
  const estimate = estimateCard();
  const progress = progressCard(stagesOf(job));
  const position = positionCard();
  const health = healthCard();
  const buttons = motionButtons(actions);
  const ending = h("div");
  root.append(
    h("h1", { class: "unseen" }, t("run.title")), ending,
    h("div", { class: "columns is-main-left is-run" },
      h("div", { class: "stack" },
        h("div", { class: "run-main" }, extra ? null : chooser(look), path.element, estimate.element), health.element),
      h("div", { class: "stack" }, progress.element, buttons.element, position.element)),
  );
  let ended = "";
  look(extra ? "path" : looksAt);

  /** Show the path or the tables; what is hidden rests. */
  function look(at) {
    looksAt = at;
    path.element.hidden = at !== "path";
    estimate.show(at === "tables");
    dispatchEvent(new Event("resize"));  // the plot of the path measures its frame anew
    store.set({});
  }

  return {
    update(state) {
      const { job, machine, link } = state;
      if (!job) return;
      const plan = rowsNow(state.plan, job);
      if (looksAt === "path") path.update(plan, machine);
      estimate.update(state);
      progress.update(state);
      position.update(state);
      health.update(state);
      buttons.update(state);
      if (looksAt === "path") path.progress(reached({ job, plan }), positionOf(state));
      const stale = isActive(job) && link.stale;
      for (const { element } of [progress, position, health, path, estimate]) {
        markStale(element, stale ? link.age_s : null);
      }
      const key = [job.id, job.error?.detail, Boolean(job.early_end), mayGoOn(job), job.health?.repeats, noticeKey(job)].join();
      if (ended !== key) {
        ended = key;
        ending.replaceChildren(...endingNotices(job), ...liveNotices(job, actions));
      }
    },
    close() {
      path.close();
      estimate.close();
      health.close();
    },
  };
}

function mountAnalysis(root, job) {
  const [stages, title, text] = computing(job);
  const progress = progressCard(stages);
  const ending = h("div");
  root.append(head(title, text), ending, progress.element);
  let ended = "";
  return {
    update(state) {
      if (!state.job) return;
      progress.update(state);
      if (ended === state.job.state) return;
      ended = state.job.state;
      ending.replaceChildren(...endingNotices(state.job));
    },
    close() {},
  };
}

const chooser = (look) => h("div", { class: "run-chooser" }, segments(t("run.look"),
  [["path", t("run.path")], ["tables", t("run.tables")]], looksAt, look, true));

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

/** Whether a measurement that was cut short may be prepared to go on. */
const mayGoOn = (job) =>
  Boolean(job.links?.verbs?.acknowledge) && RESUMABLE.has(job.kind);

/** Notices of the end of a job, or of what holds it. */
function endingNotices(job) {
  const early = earlyEndNotice(job);
  const shown = hasEnded(job) ? [...endOf(job, early), mayGoOn(job) && goesOn(job)]
    : [job.state === "cancelling" && cancelling(job), job.error && errorNotice(job, "held"), repeated(job), early];
  return shown.filter(Boolean).map((said) => h("div", { class: "below" }, said));
}

function endOf(job, early) {
  if (job.state === "succeeded") return [verdictNotice(job), early];
  const kept = isMeasuring(job) && job.run_id ? t("run.kept") : "";
  if (job.state === "cancelled") return [notice(null, t("cancel.over"), isMeasuring(job) ? t("cancel.over_text") : "", kept)];
  return [errorNotice(job) ?? notice("fault", wordOf(job.state), t("run.ended", { kind: kindOf(job.kind) }), kept)];
}

/** What acknowledging leads to, before it is asked for. */
const goesOn = (job) => notice("held", t("goon.title"), t("goon.text"),
  t(job.station ? "goon.closure_station" : "goon.closure"));

const cancelling = (job) => notice("held", t("cancel.under_way"),
  t(job.kind === "measure-standstill" ? "cancel.finishes_point" : "cancel.finishes_line"));

/** Lines that were lost and are planned anew. */
function repeated({ health }) {
  const times = health?.repeats ?? 0;
  return times ? notice(null, t("run.repeated"), t("run.repeated_text", { times: number(times) })) : null;
}

/** What the notices look like: it changes where one has to be drawn anew. */
const noticeKey = (job) => JSON.stringify([job.state, (job.notices ?? []).map(
  ({ number: n, kind, grade, is_over, action }) => [n, kind, grade, is_over, action])]);

/** Each notice, the newest first; where the machine is held for one, what may be done. */
function liveNotices(job, actions) {
  const notices = [...(job.notices ?? [])].reverse();
  const asked = job.state === "paused" && notices[0]?.action === "pause";
  return notices.map((one, i) => h("div", { class: "below", role: i === 0 ? "status" : null },
    describe(one, job), asked && i === 0 ? choice(actions) : null));
}

function describe(one, job) {
  const values = {
    axis: one.axis, row: number(one.since_row), size: quantity(one.size_um, "error"),
    u: quantity(2 * one.uncertainty_um, "error"), grade: known(`notice.${one.grade}`, one.grade),
    unit: t(job.kind === "measure-standstill" ? "notice.point" : "notice.line"),
  };
  const over = one.is_over ? t("notice.over") : "";
  const done = known(`notice.done_${one.action}`, "");
  const tone = one.is_over || hasEnded(job) ? null : "held";
  return notice(tone, known(`notice.${one.kind}`, one.kind, values), t("notice.text", values), over || done);
}

/** Lines are driven again only while the button is held: the machine moves. */
function choice(actions) {
  const button = (then) => {
    const element = h("button", { class: "button", id: `then-${then}`, "data-needs": "operator" },
      icon("play"), t(`notice.then_${then}`));
    holdToConfirm(element, () => actions.resume(then));
    return element;
  };
  return h("div", { class: "below" }, h("p", {}, t("notice.ask")),
    h("div", { class: "motion-buttons" }, button("check"), button("replan")));
}

/** Pause at a touch; resume, and end in order, held. */
function motionButtons(actions) {
  const pause = h("button", { class: "button", id: "pause", "data-needs": "operator", onclick: actions.pause },
    icon("pause"), t("run.pause"));
  const resume = h("button", { class: "button", id: "resume", "data-needs": "operator" },
    icon("play"), t("run.resume"));
  const words = h("span");
  const cancel = h("button", { class: "button", id: "cancel", "data-needs": "operator" }, icon("check"), words);
  holdToConfirm(resume, () => actions.resume());
  holdToConfirm(cancel, actions.cancel);
  const element = h("div", { class: "motion-buttons" }, pause, resume, cancel);
  return {
    element,
    update({ job, link }) {
      element.hidden = !isMoving(job);
      pause.disabled = !["running", "resuming"].includes(job.state);
      resume.disabled = job.state !== "paused" || link.stale;
      cancel.disabled = ["cancelling", "aborting"].includes(job.state) || link.stale;
      write(words, t(cancelLabel(job)));
    },
  };
}

/** A machine that is held is not moved on for the sake of being cancelled. */
function cancelLabel({ kind, state }) {
  if (state === "cancelling") return "cancel.under_way";
  if (state === "paused") return "cancel.hold_here";
  return kind === "measure-standstill" ? "cancel.hold_point" : "cancel.hold_line";
}
