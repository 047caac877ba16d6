/* What may be asked of a machine that moves, besides ABORT: absolute verbs, never a toggle. */
import { h, icon, write } from "../dom.js";
import { isMoving } from "../flow.js";
import { holdToConfirm } from "../hold.js";
import { t } from "../texts.js";

/** Pause at a touch; resume, and end in order, held. */
export function motionButtons(actions) {
  const pause = h("button", { class: "button", type: "button", id: "pause", "data-needs": "operator", onclick: actions.pause },
    icon("pause"), t("run.pause"));
  const resume = h("button", { class: "button", type: "button", id: "resume", "data-needs": "operator" },
    icon("play"), t("run.resume"));
  const words = h("span");
  const cancel = h("button", { class: "button", type: "button", id: "cancel", "data-needs": "operator" }, icon("check"), words);
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
      write(words, t(labelOf(job)));
    },
  };
}

/** A machine that is held is not moved on for the sake of being cancelled. */
function labelOf({ kind, state }) {
  if (state === "cancelling") return "cancel.under_way";
  if (state === "paused") return "cancel.hold_here";
  return kind === "measure-standstill" ? "cancel.hold_point" : "cancel.hold_line";
}
