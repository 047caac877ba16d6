/* The steps, where a job belongs among them, and which can be reached. */

/** The steps in their order, in the groups that a narrow panel shows. */
export const GROUPS = [
  { name: "set-up", steps: ["machine", "connect"] },
  { name: "measure", steps: ["plan", "check", "run"] },
  { name: "learn", steps: ["result", "discover"] },
  { name: "correct", steps: ["export", "verify", "certificate"] },
];
/** Steps that a calibration can do without. */
export const OPTIONAL = new Set(["discover", "export", "verify"]);
export const STEPS = GROUPS.flatMap(({ steps }) => steps);

/** Views that are no step. */
const BESIDE = ["records", "trend"];
const WAITS_FOR_ARMING = new Set(["ready", "awaiting-move"]);
const BEFORE_MOTION = new Set(["queued", "preparing", ...WAITS_FOR_ARMING]);
const ENDED = new Set(["succeeded", "aborted", "cancelled", "failed", "faulted", "interrupted"]);
const COMPUTING = new Set(["aligning", "estimating", "validating", "discovering", "following", "reporting"]);

export const isVerification = (job) => job?.kind === "verify";
export const isMeasuring = (job) => Boolean(job?.kind.startsWith("measure-")) || isVerification(job);
export const isExtra = (job) => job?.kind === "measure-extra";
export const isDiscovery = (job) => job?.kind === "discover" || isExtra(job);
export const isTrend = (job) => job?.kind === "trend";
export const isReanalysis = (job) => job?.kind === "reanalyse";
export const hasEnded = (job) => ENDED.has(job.state);
export const isActive = (job) => Boolean(job) && !hasEnded(job);
export const isComputing = (job) => COMPUTING.has(job.stage);
/** The job that the bar tells of: the followed one, or what is measured on this machine while an ended one is looked at. */
export const jobUnderWay = ({ job, jobs, machine_id }) => (isActive(job) ? job
  : jobs.find((other) => isMeasuring(other) && isActive(other) && (!machine_id || other.machine === machine_id)) ?? job);
export const isMoving = (job) =>
  isActive(job) && isMeasuring(job) && !BEFORE_MOTION.has(job.state) && !isComputing(job);
export const waitsForArming = (job) => WAITS_FOR_ARMING.has(job.state);
/** What people call the machine of this panel: by its record, else by its file. */
export const machineName = ({ machines, machine_id, machine }) =>
  machines.find(({ id }) => id === machine_id)?.name || machine?.name || "";
/** The control of the machine of this panel, as its record and its driver call it. */
export const controlOf = ({ machines, machine_id, machine }) =>
  [machines.find(({ id }) => id === machine_id)?.control, machine?.motion?.maker, machine?.motion?.model].filter(Boolean).join(" ");

export const isConnected = (machine) => Boolean(machine?.connected);

/** Whether tracker and control answer, and nothing about them has to be read before a plan is made. */
export const answersWell = (machine) => isConnected(machine) && Boolean(machine.tracker && machine.motion?.has_watchdog);

/** Whether a job has ended with error tables. */
export const statesTables = (job) => job?.state === "succeeded" && !isDiscovery(job) && !isTrend(job)
  && !isReanalysis(job) && !isVerification(job);

/** Whether a job states what a machine does, so that files can be made of it and points be held against it. */
export const statesMachine = (job) => statesTables(job) || (isDiscovery(job) && job.state === "succeeded");

/** Id of the job that points are held against: the followed one, or the one that a verification names; or null. */
export function heldId({ job, verification, proves }) {
  if (isVerification(job)) return verification?.asked.result_id ?? proves?.[job.id] ?? null;
  return statesMachine(job) ? job.id : null;
}

/** Id of the job whose result is taken further: the followed one, or the one that it came from; or null. */
export function resultId(state) {
  const { job, jobs } = state;
  const held = isVerification(job) ? heldId(state) : null;
  return held ? resultOf(held, jobs) : resultBehind(job, jobs);
}

/** Id of the result that a job has, or that its discovery goes on from. */
export function resultOf(id, jobs) {
  const job = jobs.find((other) => other.id === id);
  return job ? resultBehind(job, jobs) : id;
}

function resultBehind(job, jobs) {
  if (statesTables(job)) return job.id;
  if (!isDiscovery(job)) return null;
  const runs = new Set(runsOf(job));
  return jobs.find((other) => statesTables(other) && runsOf(other).some((run) => runs.has(run)))?.id ?? null;
}

const runsOf = ({ run_id, run_ids }) => (run_ids?.length ? run_ids : [run_id]).filter(Boolean);

/** The rows of the station that is measured or asked for; of one station all rows. */
export const rowsNow = (plan, job) =>
  plan?.stations?.[(job?.station?.number ?? 1) - 1] ?? plan;

/** The step that shows a job as it is now. */
export function stepOf(job) {
  if (!job) return "connect";
  if (job.state === "succeeded" && isTrend(job)) return "trend";
  if (job.state === "succeeded" && isReanalysis(job)) return "run";
  if (job.state === "succeeded" && isVerification(job)) return "verify";
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

const OF_A_RESULT = new Set(["result", "discover", "export", "verify", "certificate"]);

const OF_A_MODEL = new Set(["export", "verify"]);

/** Address of a step, or null where there is nothing to show yet. */
export function reach(step, state) {
  const { job, machine } = state;
  if (step === "machine" || step === "connect") return `#/${step}`;
  if (step === "plan") return isConnected(machine) ? "#/plan" : null;
  if (!job) return null;
  const own = stepOf(job);
  if (step === own) return `#/${step}/${job.id}`;
  if (step === "run" && (OF_A_RESULT.has(own) || own === "trend")) return `#/run/${job.id}`;
  if (!OF_A_RESULT.has(step) || !OF_A_RESULT.has(own)) return null;
  // What a discovery has found is corrected and verified as well.
  const id = OF_A_MODEL.has(step) ? heldId(state) ?? resultId(state) : resultId(state);
  return id && `#/${step}/${id}`;
}
