/* What the live estimate has noticed, and what a person may have done about it. */
import { h, icon } from "../dom.js";
import { hasEnded } from "../flow.js";
import { holdToConfirm } from "../hold.js";
import { notice } from "../parts.js";
import { known, number, t } from "../texts.js";
import { quantity } from "../units.js";

/** What the notices look like: it changes where one has to be drawn anew. */
export const noticeKey = (job) => JSON.stringify([job.state, (job.notices ?? []).map(
  ({ number: n, kind, grade, is_over, action }) => [n, kind, grade, is_over, action])]);

/** Each notice, the newest first; where the machine is held for one, what may be done. */
export function liveNotices(job, actions) {
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
    const element = h("button", { class: "button", type: "button", id: `then-${then}`, "data-needs": "operator" },
      icon("play"), t(`notice.then_${then}`));
    holdToConfirm(element, () => actions.resume(then));
    return element;
  };
  return h("div", { class: "below" }, h("p", {}, t("notice.ask")),
    h("div", { class: "motion-buttons" }, button("check"), button("replan")));
}
