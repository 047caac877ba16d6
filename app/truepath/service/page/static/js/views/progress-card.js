/* The card that says how far a job is. */
import { h, mark, write } from "../dom.js";
import { hasEnded, isActive } from "../flow.js";
import { card } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { duration, known, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { liveVerdict } from "./verdict-band.js";

/** Stages, share, time left, and how well the machine is known by now. */
export function progressCard(stages) {
  const list = h("ol", { class: "stages", "aria-label": t("run.stages") });
  const entries = new Map(stages.map((stage) => [stage, h("li", {}, t(`stage.${stage}`))]));
  list.append(...entries.values());
  const percent = h("strong", {}, "–");
  const remaining = h("b");
  const left = h("span", {}, h("span", { class: "quiet" }, t("run.remaining")), h("br"), remaining);
  const bar = h("i");
  const meter = h("div", { class: "meter", role: "progressbar", "aria-valuemin": 0, "aria-valuemax": 100,
    "aria-label": t("run.progress") }, bar);
  const count = h("span", { class: "quiet number" });
  const uncertainty = h("span", { class: "number", id: "uncertainty" });
  const said = h("div", { role: "status" });
  let told = "";
  const element = card(null, list,
    h("div", { class: "big-progress" }, percent, left), meter, h("p", { class: "beside" }, count, uncertainty), said);
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
    left.hidden = !isActive(job) || !Number.isFinite(now.eta_s);
    write(remaining, `${duration(now.eta_s)} min`);
    write(count, now.unit && now.total && isActive(job)
      ? t("run.count", { done: number(now.done), total: number(now.total),
        unit: known(`unit.${now.unit}`, now.unit ?? "") }) : "");
    write(uncertainty, isActive(job) ? uncertaintyText(job, estimate) : "");
    showVerdict(isActive(job) ? estimate?.verdict : null);
  }

  /** Drawn anew only where it has changed: it is read aloud. */
  function showVerdict(verdict) {
    const now = JSON.stringify(verdict ?? null);
    if (now === told) return;
    told = now;
    said.replaceChildren(...[liveVerdict(verdict)].filter(Boolean));
  }

  function markStages(job, stage) {
    const at = job.state === "succeeded" ? stages.length : stages.indexOf(stage);
    [...entries.values()].forEach((entry, i) => {
      mark(entry, "data-done", i < at ? "" : null);
      mark(entry, "aria-current", i === at ? "step" : null);
    });
  }
}

/** The expanded uncertainty now, and the one at which measuring ends. */
function uncertaintyText(job, estimate) {
  if (!estimate) return "";
  const value = quantity(COVERAGE * estimate.volumetric_uncertainty_um, "error");
  if (job.target_um === null || job.target_um === undefined) return t("run.uncertainty", { value });
  const target = quantity(COVERAGE * job.target_um, "error");
  return t("run.uncertainty_target", { value, target });
}
