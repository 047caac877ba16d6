/* How a job has ended, or why it stands, and how it can go on. */
import { h } from "../dom.js";
import { hasEnded, isMeasuring } from "../flow.js";
import { earlyEndNotice, errorNotice, kindOf, notice, wordOf } from "../parts.js";
import { number, t } from "../texts.js";
import { verdictNotice } from "./verdict-band.js";

const RESUMABLE = new Set(["measure-otf", "measure-standstill", "measure-extra"]);

/** Whether a measurement that was cut short may be prepared to go on. */
export const mayGoOn = (job) =>
  Boolean(job.links?.verbs?.acknowledge) && RESUMABLE.has(job.kind);

/** Notices of the end of a job, or of what holds it. */
export function endingNotices(job) {
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
