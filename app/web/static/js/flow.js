/* The steps, where a job belongs among them, and which can be reached. */
export const STEPS = ["connect", "plan", "check", "run", "result", "discover"];

/** Views that are no step. */
const BESIDE = ["records", "trend"];
const WAITS_FOR_ARMING = new Set(["ready", "awaiting-move"]);
const BEFORE_MOTION = new Set(["queued", "preparing", ...WAITS_FOR_ARMING]);
const ENDED = new Set(["succeeded", "aborted", "cancelled", "failed", "faulted", "interrupted"]);
const COMPUTING = new Set(["aligning", "estimating", "validating", "discovering", "following", "reporting"]);

export const isMeasuring = (job) => Boolean(job?.kind.startsWith("measure-"));
export const isExtra = (job) => job?.kind === "measure-extra";
export const isDiscovery = (job) => job?.kind === "discover" || isExtra(job);
export const isTrend = (job) => job?.kind === "trend";
export const isReanalysis = (job) => job?.kind === "reanalyse";
export const hasEnded = (job) => ENDED.has(job.state);
export const isActive = (job) => Boolean(job) && !hasEnded(job);
export const isComputing = (job) => COMPUTING.has(job.stage);
export const isMoving = (job) =>
  isActive(job) && isMeasuring(job) && !BEFORE_MOTION.has(job.state) && !isComputing(job);
export const waitsForArming = (job) => WAITS_FOR_ARMING.has(job.state);
export const isConnected = (machine) => Boolean(machine?.connected);

/** The rows of the station that is measured or asked for; of one station all rows. */
export const rowsNow = (plan, job) =>
  plan?.stations?.[(job?.station?.number ?? 1) - 1] ?? plan;

/** The step that shows a job as it is now. */
export function stepOf(job) {
  if (!job) return "connect";
  if (job.state === "succeeded" && isTrend(job)) return "trend";
  if (job.state === "succeeded" && isReanalysis(job)) return "run";
  if (job.state === "succeeded") return isDiscovery(job) ? "discover" : "result";
  if (isMeasuring(job) && BEFORE_MOTION.has(job.state)) return "check";
  return "run";
}

/** Address of the step that shows a job. */
export const addressOf = (job) => (job ? `#/${stepOf(job)}/${job.id}` : "#/connect");

/** Step and job id of an address. */
export function place(hash) {
  const [, step = "", id = null] = hash.match(/^#\/(\w+)(?:\/([\w-]+))?$/) ?? [];
  const found = STEPS.includes(step) || BESIDE.includes(step) ? step : null;
  return { step: found, id };
}

/** Address of a step, or null where there is nothing to show yet. */
export function reach(step, { job, machine }) {
  if (step === "connect") return "#/connect";
  if (step === "plan") return isConnected(machine) ? "#/plan" : null;
  if (!job) return null;
  const own = stepOf(job);
  if (step === own) return `#/${step}/${job.id}`;
  if (step === "run" && ["result", "discover", "trend"].includes(own)) return `#/run/${job.id}`;
  if (step === "discover" && own === "result") return `#/discover/${job.id}`;
  return null;
}
