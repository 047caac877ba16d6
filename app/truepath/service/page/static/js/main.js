/* Wires store, stream, views and shell together. */
import { createActions, NO_COURSE } from "./actions.js";
import * as api from "./api.js";
import { addressOf, hasEnded, isActive, isMeasuring, isMoving, place, stepOf } from "./flow.js";
import { preference } from "./preferences.js";
import { check as checkSession, enter, leave } from "./session.js";
import { updateBar, updateLead, updateProblems, updateSteps } from "./shell.js";
import { createStore } from "./store.js";
import { listen, STALE_MS } from "./stream.js";
import { t } from "./texts.js";
import * as certificate from "./views/certificate.js";
import * as check from "./views/check.js";
import { replaceCondition } from "./views/conditions-card.js";
import * as connect from "./views/connect.js";
import * as discover from "./views/discover.js";
import * as exporting from "./views/export.js";
import * as machine from "./views/machine.js";
import * as plan from "./views/plan.js";
import * as records from "./views/records.js";
import * as result from "./views/result.js";
import * as run from "./views/run.js";
import { toggleSettings } from "./views/settings.js";
import * as trend from "./views/trend.js";
import * as verify from "./views/verify.js";

const VIEWS = { machine, connect, plan, check, run, result, discover, export: exporting, verify, certificate, records, trend };
const RETRY_MS = 2000;
const RECENT_MS = 3600e3;

const store = createStore({
  system: null, machine: null, machines: [], machine_id: null, job: null, jobs: [], runs: [], plan: null, result: null, discovery: null, trend: null, verification: null,
  conditions: null, safetyRead: null, arming: null, live: null, estimate: null, course: NO_COURSE, estimateStale: null, problem: null, deviceError: null, busy: null, planned: null, asked: null, proves: {}, done: {}, issued: null,
  link: { stale: false, asked: false, last: null, age_s: 0 },
});
const go = (address) => {
  if (location.hash === address) route();
  else location.hash = address;
};
const actions = createActions(store, go);
const context = { store, actions, go };
const root = document.getElementById("main");
let mounted = null;
let current = null;

const mustChoose = (machines) => machines.filter(({ cell }) => cell !== "none").length > 1 && !preference("machine");

/** Show the view that the address names. */
async function route() {
  const { step, id } = place(location.hash);
  if (!step) {
    const { job, machines } = store.get();
    // With one machine there is nothing to choose.
    go(job || !mustChoose(machines) ? addressOf(job) : "#/machine");
    return;
  }
  if (id) await actions.open(id);
  if (place(location.hash).step !== step) return;
  show(step);
}

function show(step, focus = true) {
  mounted?.close();
  root.replaceChildren();
  for (const sheet of document.querySelectorAll("dialog[open]")) if (sheet.id !== "settings") sheet.close();
  current = step;
  mounted = VIEWS[step].mount(root, context);
  render(store.get());
  if (!focus) return;
  scrollTo({ top: 0 });
  root.focus({ preventScroll: true });
}

function render(state) {
  if (!mounted) return;
  follow(state);
  updateBar(state);
  updateSteps(state, current);
  updateProblems(state, actions.dismiss);
  updateLead(permitted(VIEWS[current].lead(state, context)), state.link, state.job);
  mounted.update(state);
}

const NEEDS_OPERATOR = new Set(["connect", "prepare", "arm", "extra", "follow", "discover", "ask", "verify", "acknowledge"]);
const NEEDS_METROLOGIST = new Set(["issue"]);

/** Offer a role only what it may do, and what leads elsewhere. */
function permitted(lead) {
  const { role } = document.body.dataset;
  const key = lead.next?.key;
  const closed = (reason) => ({ ...lead, next: null, reason: t(reason) });
  if (role === "viewer" && NEEDS_OPERATOR.has(key)) return closed("session.viewer_only");
  if (["viewer", "operator"].includes(role) && NEEDS_METROLOGIST.has(key)) return closed("session.metrologist_only");
  return lead;
}

let seen = {};

/** Go with the job from step to step: armed → Run, done → Result.
 *
 * From where the operator is bound for, which is not yet what is shown; and not while he
 * calls the job off: that has a place of its own to lead to.
 */
function follow({ job, asked }) {
  const before = seen;
  seen = job ? { id: job.id, state: job.state, step: stepOf(job) } : {};
  if (!job || before.state === job.state) return;
  actions.fetchPlan();
  actions.fetchResult();
  const known = before.id === job.id;
  const { step } = place(location.hash);
  const moved = known && before.step !== seen.step && step === before.step && asked !== "abort";
  const begun = !known && step === "connect" && isMeasuring(job) && isActive(job);
  if (moved || begun) go(addressOf(job));
}

function hear(type, data) {
  const { job } = store.get();
  if (type === "refused") checkSession();
  if (type === "job") actions.hear(data);
  if (type === "condition") hearCondition(data);
  if (data.type === "devices-connected" || (type === "open" && mounted)) actions.loadSystem().catch(api.expectProblem);
  if (type === "open" && job) actions.fetchEstimate();
  const own = job && !hasEnded(job) && (data.job_id ?? job.id) === job.id;
  if (type === "progress" && own) {
    const { stage, progress, health } = data;
    store.set({ job: { ...job, stage, progress, health } });
  }
  if (type === "live" && own) store.set({ live: data });
  if (type === "estimate" && own) {
    estimated = { at: Date.now(), ms: performance.now() };
    actions.hearEstimate(data);
  }
}

/** Show a change of a condition at once, where somebody looks at those of this machine. */
function hearCondition({ machine, ...told }) {
  const { conditions, machine_id } = store.get();
  if (conditions && machine === machine_id) store.set({ conditions: replaceCondition(conditions, told) });
}

let estimated = null;

/** When the estimate was last told, if that is too long ago for a machine that moves. */
function estimateStale({ job, estimate }) {
  const due = estimate && estimated && isMoving(job);
  return due && performance.now() - estimated.ms > STALE_MS ? estimated.at : null;
}

let linked = {};

function age(link) {
  const changed = link.stale !== linked.stale || link.asked !== linked.asked || link.age_s !== linked.age_s
    || Boolean(link.last) !== Boolean(linked.last);
  const answers = linked.stale && !link.stale;
  const regained = (linked.stale || linked.asked) && !link.stale && !link.asked;
  if (changed) store.set({ link });
  const stale = estimateStale(store.get());
  if (stale !== store.get().estimateStale) store.set({ estimateStale: stale });
  linked = link;
  if (answers) actions.regain();
  if (regained) load().catch(actions.refuse);
}

/** Ask for what events would have told. */
async function ask() {
  const { job } = store.get();
  for (const other of await api.newestJobs()) actions.hear(other);
  if (job) actions.hear(await api.newestJob(job.id));
  if (job && isMoving(job)) await actions.fetchEstimate();
}

async function load() {
  await Promise.all([actions.loadSystem(), actions.loadRecords()]);
  const { jobs, job } = store.get();
  const active = jobs.find((other) => isMeasuring(other) && isActive(other)) ?? jobs.find(isActive);
  if (job) actions.hear(await api.job(job.id));
  else if (active) actions.follow(active);
  else if (!location.hash && justDone(jobs[0])) actions.follow(jobs[0]);
}

/** Who opens the page after the run came for its result. */
function justDone(job) {
  return job?.state === "succeeded" && Date.now() - Date.parse(job.ended) < RECENT_MS;
}

/** The service may still be starting: try until it answers. */
async function start() {
  try {
    await load();
  } catch (error) {
    api.expectProblem(error);
    actions.refuse(error);
    setTimeout(start, RETRY_MS);
    return;
  }
  actions.dismiss();
}

// A file that misses its zone would be opened in place of the page.
for (const type of ["dragover", "drop"]) addEventListener(type, (event) => event.preventDefault());
/** In other words or colours; before the first view there is nothing to draw anew. */
function showAgain() {
  if (mounted) show(current, false);
}

document.getElementById("open-settings").addEventListener("click", () => toggleSettings(showAgain));
document.addEventListener("truepath:themed", showAgain);
document.addEventListener("truepath:logged-out", leave);
await enter(root);
addEventListener("hashchange", route);
store.listen(render);
listen(hear, age, ask);
await start();
await document.fonts.ready;
await route();
