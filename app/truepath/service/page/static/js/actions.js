/* What the operator can ask for; the answers go to the store. */
import * as api from "./api.js";
import { addressOf, answersWell, hasEnded, isActive, isDiscovery, isExtra, isMeasuring, isTrend, isVerification, place } from "./flow.js";
import { withModel } from "./model-choice.js";
import { prefer, preference } from "./preferences.js";
import { wordProblem } from "./problems.js";
import { t } from "./texts.js";

const KEPT_JOBS = 50;
const PLAN_LOOK_MS = 300;
const COURSE = ["elapsed_s", "done", "volumetric_uncertainty_um"];

/** The course of the uncertainty before the first estimate. */
export const NO_COURSE = Object.fromEntries(COURSE.map((name) => [name, []]));

/** Bind the actions to a store; `go(address)` changes the step. */
export function createActions(store, go) {
  let arming = null;

  /** Run one request at a time under a name; a refusal becomes the problem shown. */
  async function during(busy, work) {
    if (store.get().busy) return null;
    store.set({ busy, problem: null });
    try {
      return await work();
    } catch (error) {
      refuse(error);
      return null;
    } finally {
      store.set({ busy: null });
    }
  }

  function refuse(error) {
    api.expectProblem(error);
    const offer = error.code === "not-in-control" ? { label: t("control.take"), run: takeControl } : null;
    store.set({ problem: { ...worded(error), code: error.code, tone: "fault", offer } });
  }

  /** Open the ports; what they refuse stays with the devices until they answer. */
  async function openPorts() {
    try {
      await api.connect();
    } catch (error) {
      if (error instanceof api.Problem) store.set({ deviceError: { problem: error, at: new Date().toISOString() } });
      throw error;
    }
    store.set({ deviceError: null });
  }

  async function loadSystem() {
    const [system, machines] = await Promise.all([api.system(), api.machines()]);
    const id = chosenOf(machines);
    api.chooseMachine(id);
    store.set({ system, machines, machine_id: id ?? machines[0]?.id ?? null, machine: await api.machine() });
  }

  /** Work with another machine; this panel keeps to it. */
  const choose = (id) => during("choose", async () => {
    prefer("machine", id);
    store.set({ deviceError: null });
    await loadSystem();
  });

  async function loadRecords() {
    const [jobs, runs] = await Promise.all([api.jobs(KEPT_JOBS), api.runs()]);
    store.set({ jobs: jobs.filter((job) => job.kind !== "plan"), runs });
  }

  /** Take over what the service says of a job: the followed one, or one that now moves.
   *
   * Answers and events come by two ways, in any order: what is older says nothing.
   */
  function hear(told) {
    if (told.kind === "plan") return; // it belongs to the request that asked for it
    const { job: followed, jobs } = store.get();
    const others = jobs.filter((other) => other.id !== told.id);
    const known = jobs.find((other) => other.id === told.id);
    const job = newer(known ?? told, told);
    const begins = isMeasuring(job) && isActive(job) && job.state !== "aborting";
    store.set({ jobs: [job, ...others].sort(byCreation).slice(0, KEPT_JOBS) });
    if (job.state === "faulted" && job.error && known?.state !== "faulted") {
      store.set({ deviceError: { problem: job.error, at: job.ended ?? job.created } });
    }
    if (followed?.id === job.id) store.set({ job: newer(followed, job) });
    else if (begins && (!followed || hasEnded(followed))) follow(job);
  }

  /** Follow a job and fetch what belongs to it: its plan, its result. */
  function follow(job) {
    const { job: before } = store.get();
    const other = before?.id !== job.id;
    const forgotten = { live: null, estimate: null, course: NO_COURSE, plan: null, result: null, discovery: null, trend: null, verification: null };
    store.set({ job, ...(other ? forgotten : {}) });
    fetchPlan();
    fetchResult();
    if (other) fetchEstimate();
  }

  /** What has been estimated before this page came; a few extra lines have no tables. */
  async function fetchEstimate() {
    const { job } = store.get();
    if (!job || !isMeasuring(job) || isExtra(job) || isVerification(job) || !job.started) return;
    await keep("estimate", job, api.estimate);
    const { estimate } = store.get();
    if (estimate?.course) store.set({ course: estimate.course });
  }

  /** Take a newer estimate; one that is only told again adds nothing to the course. */
  function hearEstimate(estimate) {
    const { course } = store.get();
    const step = COURSE.map((name) => estimate[name]);
    const last = COURSE.map((name) => course[name].at(-1));
    const again = step.every((value, i) => value === last[i]);
    const longer = again ? course
      : Object.fromEntries(COURSE.map((name, i) => [name, [...course[name], step[i]]]));
    store.set({ estimate, course: longer });
  }

  async function fetchPlan() {
    const { job, plan } = store.get();
    if (!job || plan || !isMeasuring(job) || ["queued", "preparing"].includes(job.state)) return;
    await keep("plan", job, api.plan);
  }

  async function fetchResult() {
    const { job, result, discovery, trend, verification } = store.get();
    if (job?.state !== "succeeded" || result || discovery || trend || verification) return;
    if (isTrend(job)) {
      await keep("trend", job, api.trend);
      return;
    }
    if (isVerification(job)) {
      await keep("verification", job, api.verification);
      return;
    }
    if (isDiscovery(job)) {
      await keep("discovery", job, api.discovery);
      return;
    }
    await keep("runs", job, api.runs);
    await keep("result", job, api.result);
  }

  async function keep(name, { id }, load) {
    try {
      const content = await load(id);
      if (store.get().job?.id === id) store.set({ [name]: content });
    } catch (error) {
      // A job that was aborted early has no plan; that is nothing to report.
      if (!(error instanceof api.Problem) || ![404, 409].includes(error.status)) refuse(error);
    }
  }

  /** Ask something of the followed job; whether it was taken. */
  async function verb(name, send) {
    const { job } = store.get();
    // Never behind another request: a pause must not wait for a connect.
    store.set({ asked: name, problem: null });
    try {
      hear(await send(job));
      return true;
    } catch (error) {
      refuse(error);
      await reload(job.id);
      return false;
    } finally {
      store.set({ asked: null });
    }
  }

  /** Take over who may arm and resume the followed job; nothing moves. */
  async function takeControl() {
    const isTaken = await verb("take-control", api.takeControl);
    if (isTaken) store.set({ problem: { title: t("control.taken"), text: t("control.taken_text"), tone: null } });
    return isTaken;
  }

  /** After a refusal the service's word counts, not ours. */
  async function reload(id) {
    try {
      hear(await api.job(id));
    } catch (error) {
      if (!store.get().problem) refuse(error);
    }
  }

  /** The service answers again: that it does not is true no more. */
  function regain() {
    if (store.get().problem?.code === "unreachable") store.set({ problem: null });
  }

  /** Make a job; where `request` asks for a plan, of the rows that are planned first. */
  async function begin(order, request = null) {
    const tell = (planned) => store.set({ planned });
    tell(null);
    const { machine } = store.get();
    const job = await during("prepare", async () => api.createJob(withModel(
      request ? { ...order, plan_id: (await makePlan(withModel(request, machine), tell)).id } : order, machine)));
    if (!job) return null;
    hear(job);
    follow(job);
    go(addressOf(job));
    return job;
  }

  /** Drive points that a result was not made from, and hold it against them. */
  async function verify(order) {
    const job = await begin({ kind: "verify", ...order });
    if (job) store.set({ proves: { ...store.get().proves, [job.id]: order.result_id } });
  }

  /** Issue a certificate of a result; null where it is refused. */
  const issue = (id, order) => during("issue", () => api.issueCertificate(id, order));
  const preview = (id, order) => during("preview", () => api.previewCertificate(id, order));

  return {
    loadSystem, loadRecords, hear, hearEstimate, follow, fetchEstimate, fetchPlan, fetchResult, refuse, regain,
    /** Open the ports; on to the plan, unless what has answered has to be looked at first. */
    connect: () => during("connect", async () => {
      await openPorts();
      await loadSystem();
      const { machine, job } = store.get();
      if (answersWell(machine) && !isActive(job) && place(location.hash).step === "connect") go("#/plan");
    }),
    prepare: begin,
    /** Keep that a step that may be left out was done for a result. */
    did: (step, id) => store.set({ done: { ...store.get().done, [id]: { ...store.get().done[id], [step]: true } } }),
    verify, issue, preview, choose,
    /** Have a plan made to look at, with its curve; null where it is refused. Nothing waits for it. */
    async foresee(request, tell) {
      try {
        return withCurve(await makePlan(withModel(request, store.get().machine), tell));
      } catch (error) {
        refuse(error);
        return null;
      }
    },
    /** A plan that was made before, with its curve; null where there is none. */
    findPlan: (id) => api.planned(id).then(withCurve).catch(() => null),
    /** Ask for the token as the hold begins; a refusal is shown once the hold is done. */
    beginHold() {
      arming = api.prepareArming(store.get().job);
      arming.catch(() => {});
    },
    /** Only what the page shows may move: a plan that has changed since is shown first. */
    arm: () => verb("arm", async (job) => {
      const [given, { arming: shown }] = [await arming, store.get()];
      if (shown && shown.plan_sha256 !== given.plan_sha256) throw new api.Problem(409, { code: "arm-token-other" });
      return api.arm(job, given);
    }),
    takeControl,
    pause: () => verb("pause", api.pause),
    /** Go on; `then` says what to do first about what was noticed. */
    resume: (then = "note") => verb("resume", (job) => api.resume(job, then)),
    cancel: () => verb("cancel", api.cancel),
    acknowledge: () => verb("acknowledge", api.acknowledge),
    abort: () => verb("abort", api.abort),
    analyse: (run) => begin({ kind: "analyse", run_id: run }),
    validate: (run) => begin({ kind: "analyse", run_id: run, monte_carlo: {} }),
    discover: (run) => begin({ kind: "discover", run_id: run }),
    driveExtra: ({ id }, order) => begin({ kind: "measure-extra", discovery_id: id, ...order }),
    async upload(file) {
      const run = await during("upload", () => api.upload(file));
      if (run) await begin({ kind: "analyse", run_id: run.id });
    },
    /** Open a job by id, as an address names it. */
    async open(id) {
      if (store.get().job?.id === id) return;
      try {
        follow(await api.job(id));
      } catch (error) {
        refuse(error);
        go("#/records");
      }
    },
    dismiss: () => store.set({ problem: null }),
    forgetDeviceError: () => store.set({ deviceError: null }),
  };
}

const withCurve = async (plan) => ({ ...plan, curve: await api.planCurve(plan.id) });

/** Have a plan made; tells how far it is, answers it once it is there. */
async function makePlan(request, tell) {
  let plan = await api.createPlan(request);
  while (!hasEnded(plan)) {
    await new Promise((resolve) => setTimeout(resolve, PLAN_LOOK_MS));
    plan = await api.planned(plan.id);
    tell(plan.progress);
  }
  if (plan.state !== "succeeded") throw new api.Problem(422, plan.error ?? {});
  return plan;
}

/** The machine that this panel works with, where the service drives several. */
function chosenOf(machines) {
  const driven = machines.filter(({ cell }) => cell !== "none");
  if (driven.length < 2) return null;
  return (driven.find(({ id }) => id === preference("machine")) ?? driven[0]).id;
}

const byCreation = (a, b) => (a.created < b.created ? 1 : -1);

const newer = (a, b) => ((b.version ?? 0) >= (a.version ?? 0) ? b : a);

function worded(problem) {
  if (problem.status === 412) {
    return { title: t("problem.stale"), text: "", action: t("problem.stale_action") };
  }
  return wordProblem(problem);
}
