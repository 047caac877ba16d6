/* The REST interface. Every refusal arrives as a Problem (RFC 9457). */
/** Where ABORT goes as well: what shows this page well stops the machine. */
export const ROOT = document.getElementById("abort-form").action.replace(/\/stop$/, "");
const PATIENCE_MS = 15000;
const SHORT_MS = 2000;
const NEWEST = 5;

/** What the service refused, in its own words: title, detail, action, status, code. */
export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `HTTP ${status}`);
    this.status = status;
    this.title = body.title || "";
    this.detail = body.detail || "";
    this.action = body.action || "";
    this.code = body.code || "";
    this.controller = body.controller || "";
  }
}

/** Throw what is no refusal of the service. */
export function expectProblem(error) {
  if (!(error instanceof Problem)) throw error;
}

async function call(method, path, { json, form, version, key, patience_ms = PATIENCE_MS } = {}) {
  const headers = { Accept: "application/json" };
  if (json !== undefined) headers["Content-Type"] = "application/json";
  if (version !== undefined) headers["If-Match"] = `"${version}"`;
  if (key !== undefined) headers["Idempotency-Key"] = key;
  const body = form ?? (json === undefined ? undefined : JSON.stringify(json));
  const signal = AbortSignal.timeout(patience_ms);
  let answer;
  let text;
  try {
    answer = await fetch(ROOT + path, { method, headers, body, signal, cache: "no-store" });
    text = await answer.text();
  } catch {
    throw silence(method);
  }
  const content = read(text, answer, method);
  if (content.code === "not-logged-in") document.dispatchEvent(new CustomEvent("truepath:logged-out"));
  if (!answer.ok) throw new Problem(answer.status, content);
  return content;
}

/** The document of an answer. One cut short is no document; a refusal on the way may have none. */
function read(text, { ok }, method) {
  try {
    return text ? JSON.parse(text) : {};
  } catch {
    if (ok) throw silence(method);
    return {};
  }
}

/** No answer. What was only asked for is asked for again; what was to be done may have been done. */
const silence = (method) => new Problem(0, { code: method === "GET" ? "unreachable" : "unanswered" });

const items = (page) => page.items ?? page;

/** Who works here, and whether anybody has to log in. */
export const session = () => call("GET", "/session");
/** Log in; the session is in a cookie that no script reads. */
export const logIn = (name, password) => call("POST", "/session", { json: { name, password, cookie: true } });
export const logOut = () => call("DELETE", "/session");

export const system = () => call("GET", "/system");

let chosen = null;

/** Work with one of several machines from now on; null where there is only one. */
export function chooseMachine(id) {
  chosen = id;
}

/** The machine and who answers on its ports; null where none is set up. */
export async function machine() {
  try {
    return chosen ? await oneOfSeveral(chosen) : await call("GET", "/machines/current");
  } catch (problem) {
    if (problem.status === 404) return null;
    throw problem;
  }
}

/** To connect again is harmless; it tells who answers. */
async function oneOfSeveral(id) {
  const { machine_file: { tracker: tracker_noise, motion: motion_limits, ...file }, name, connected } = await machineRecord(id);
  const devices = connected ? await connect() : { connected, tracker: null, motion: null };
  return { ...file, name, tracker_noise, motion_limits, ...devices };
}

export const connect = () =>
  call("POST", `/machines/${chosen ?? "current"}:connect`, { patience_ms: 60000 });

/** An order with the machine that it is for, where there are several and nothing else names one. */
const withMachine = (order) => {
  const isNamed = !chosen || ["plan_id", "discovery_id", "continues", "run_id", "run_ids"].some((name) => name in order);
  return isNamed ? order : { ...order, machine: chosen };
};

/** All machines that the service knows, those it drives first. */
export const machines = async () => items(await call("GET", "/machines"));
export const machineRecord = (id) => call("GET", `/machines/${id}`);
/** Say who a machine is. */
export const changeMachine = (id, change) => call("PATCH", `/machines/${id}`, { json: change });
/** Add a machine by its machine file; its devices are chosen next. */
export const addMachine = (id, file) => call("POST", "/machines", { json: { id, machine_file: file } });
/** Describe a machine anew; nothing moves. */
export const describeMachine = (id, file) => call("PUT", `/machines/${id}/machine-file`, { json: { machine_file: file }, patience_ms: 60000 });
/** Drive a machine no more, by the version that was read; what was measured of it stays. */
export const removeMachine = ({ id, version }) => call("DELETE", `/machines/${id}`, { version, patience_ms: 60000 });
/** The installed drivers and their options. */
export const drivers = async () => items(await call("GET", "/drivers"));
/** Choose drivers and options; no port is opened yet. */
export const setDevices = (id, devices) => call("PUT", `/machines/${id}/devices`, { json: devices, patience_ms: 60000 });
/** Connect and listen to the tracker for a second; nothing moves. */
export const tryDevices = (id) => call("POST", `/machines/${id}/devices:try`, { patience_ms: 60000 });
/** The volumetric error over all calibrations of a machine. */
export const machineHistory = (id) => call("GET", `/machines/${id}/history`);
/** How the errors of a machine depend on its temperature. */
export const machineTemperature = (id) => call("GET", `/machines/${id}/temperature`, { patience_ms: 120000 });
/** What has changed between two calibrations of a machine, by their jobs. */
export const machineChanges = (id, since, until) => call("GET", `/machines/${id}/changes?${new URLSearchParams({ since, until })}`);
export const machineStanding = (id) => call("GET", `/machines/${id}/standing`);

/** What has to be so before the machine moves. */
export const conditions = async () => items(await call("GET", `/machines/${chosen ?? "current"}/conditions`));

export const job = (id) => call("GET", `/jobs/${id}`);
export const jobs = async (limit) => items(await call("GET", `/jobs?limit=${limit}`));

/** Give a job the name that people know it by; an empty one takes it away. */
export const renameJob = (id, name) => call("PATCH", `/jobs/${id}`, { json: { name } });

/** What is asked for each second while no events come: soon answered, or not at all. */
export const newestJob = (id) => call("GET", `/jobs/${id}`, { patience_ms: SHORT_MS });
export const newestJobs = async () =>
  items(await call("GET", `/jobs?limit=${NEWEST}`, { patience_ms: SHORT_MS }));

/** Make a job. The key makes one of it, even if the request is sent twice. */
export const createJob = (order) => call("POST", "/jobs", { json: withMachine(order), key: newKey() });
/** Ask for a plan; follow it with `planned`. */
export const createPlan = (request) => call("POST", "/plans", { json: withMachine(request), key: newKey() });
export const planned = (id) => call("GET", `/plans/${id}`);
/** Uncertainty against time along a plan. */
export const planCurve = (id) => call("GET", `/plans/${id}/curve`);
export const plan = async (id) => withStations(await call("GET", `/jobs/${id}/plan`));
/** The rows of each of several stations as a plan of its own. */
const withStations = (whole) => (whole.stations
  ? { ...whole, stations: whole.stations.map((rows) => ({ ...whole, ...rows, stations: null })) } : whole);
export const grade = (id, place_mm) =>
  call("GET", `/jobs/${id}/plan/grade?${new URLSearchParams(place_mm.map((v) => ["tracker_mm", v]))}`);
export const dialects = async () => items(await call("GET", "/nc-dialects"));
/** The newest estimate of a measurement; null before its first. */
export const estimate = async (id) => {
  const newest = await call("GET", `/jobs/${id}/estimate`);
  return newest.error_tables ? newest : null;
};
export const discovery = (id) => call("GET", `/jobs/${id}/discovery`);
/** A model and those it came from, the newest first. */
export const modelVersions = (id) => call("GET", `/models/${id}/versions`);
export const trend = (id) => call("GET", `/jobs/${id}/trend`);
export const result = (id) => call("GET", `/jobs/${id}/result`);

/** The volumetric error before and after, held against the tolerance of the machine, and its mean against one that is given. */
export const volumetricError = (id, tolerance_um) =>
  call("GET", `/jobs/${id}/result/volumetric-error${tolerance_um === null ? "" : `?tolerance_um=${tolerance_um}`}`);
/** The map of a state: before, after, or after by the kept files of that name. */
export const volumetricMap = (id, state) =>
  call("GET", `/jobs/${id}/result/volumetric-map?${new URLSearchParams(
    ["before", "after"].includes(state) ? { state } : { state: "after", compensation: state })}`, { patience_ms: 60000 });
export const verification = (id) => call("GET", `/jobs/${id}/verification`);
export const compensations = async (id) => items(await call("GET", `/jobs/${id}/compensations`));

/** Hold a result against a direct measurement; the uncertainties are standard ones of the reference (k = 1). */
export function compareWithReference(id, file, { reference_um, reference_urad }) {
  const form = new FormData();
  form.append("reference", file, file.name);
  const query = new URLSearchParams({ reference_um, reference_urad });
  return call("POST", `/jobs/${id}/comparisons?${query}`, { form, patience_ms: 120000 });
}

/** What discovery looks for, in the words of a language. */
export const effects = async (language) => items(await call("GET", `/effects?language=${language}`));
export const formats = async () => items(await call("GET", "/compensation-formats"));
/** Have compensation files made; answers what they leave. */
export const createCompensation = (id, order) =>
  call("POST", `/jobs/${id}/compensations`, { json: order, patience_ms: 60000 });

/** The files that the control of a simulated machine has; give it others, or take them away. */
export const simulatedTables = (machine) => call("GET", `/machines/${machine}/simulated-tables`);
export const loadSimulatedTables = (machine, files) =>
  call("PUT", `/machines/${machine}/simulated-tables`, { json: files, patience_ms: 60000 });
export const clearSimulatedTables = (machine) => call("DELETE", `/machines/${machine}/simulated-tables`, { patience_ms: 60000 });

/** Certificates of a result, and what is kept of who its machine is. */
export const certificates = (id) => call("GET", `/jobs/${id}/certificates`);
/** Issue one; it never changes. */
export const issueCertificate = (id, order) =>
  call("POST", `/jobs/${id}/certificates`, { json: order, patience_ms: 180000 });
/** What issuing would make; keeps nothing. */
export const previewCertificate = (id, order) =>
  call("POST", `/jobs/${id}/certificates/preview`, { json: order, patience_ms: 60000 });
/** A certificate as the page that was issued. */
export async function certificatePage({ links: { html } }) {
  const answer = await fetch(locate(html), { cache: "no-store" });
  if (!answer.ok) throw new Problem(answer.status, {});
  return answer.text();
}

/** What a job will move, and the token that arms it. */
export const prepareArming = ({ id }) => call("POST", `/jobs/${id}/arming`);
export const arm = ({ id, version }, { token }) =>
  call("POST", `/jobs/${id}/arm`, { version, json: { token } });
export const pause = ({ id }) => call("POST", `/jobs/${id}/pause`);
export const resume = ({ id, version }, then = "note") =>
  call("POST", `/jobs/${id}/resume${then === "note" ? "" : `?then=${then}`}`, { version });
/** End in order: the line or point under way is finished first. */
export const cancel = ({ id }) => call("POST", `/jobs/${id}/cancel`);
/** Prepare a measurement that was cut short to go on; moves nothing. */
export const acknowledge = ({ id }) => call("POST", `/jobs/${id}/acknowledge`);
export const takeControl = ({ id }) => call("POST", `/jobs/${id}/take-control`);
export const abort = ({ id }) => call("POST", `/jobs/${id}/abort`);

export const runs = async () => items(await call("GET", "/runs"));

// Not randomUUID: a panel that reaches the service over plain HTTP has none.
const newKey = () =>
  Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");

/** Send a bundle; answers the Run. */
export function upload(file) {
  const form = new FormData();
  form.append("bundle", file, file.name);
  return call("POST", "/runs", { form, patience_ms: 600000 });
}

/** Keep lengths that are known otherwise with a Run; answers how many. */
export function sendKnownLengths(id, file) {
  const form = new FormData();
  form.append("known_lengths", file, file.name);
  return call("PUT", `/runs/${id}/known-lengths`, { form, patience_ms: 60000 });
}

/** An address that the service states, as it is behind a proxy that the service may not know. */
export const locate = (address) => address.replace(/^.*?\/api\/v1(?=\/)/, ROOT);

/** Addresses of what can be taken away. */
export const links = {
  program: (id, dialect) => `${ROOT}/jobs/${id}/nc-program?dialect=${encodeURIComponent(dialect)}`,
  csv: (id) => `${ROOT}/jobs/${id}/result/error-tables.csv`,
  /** The tables of a result that is not to be used: given out to who accepts that. */
  acceptedCsv: (id) => `${links.csv(id)}?accept_verdict=true`,
  json: (id) => `${ROOT}/jobs/${id}/result`,
  discoveryReport: (id) => `${ROOT}/jobs/${id}/discovery/report.html`,
  verificationReport: (id) => `${ROOT}/jobs/${id}/verification/report.html`,
  trend: (id) => `${ROOT}/jobs/${id}/trend`,
  trendReport: (id) => `${ROOT}/jobs/${id}/trend/report.html`,
  model: (id) => `${ROOT}/models/${id}`,
  report: (id) => `${ROOT}/jobs/${id}/result/report.html`,
  bundle: (run) => `${ROOT}/runs/${run}/bundle`,
  events: `${ROOT}/events`.replace(/^http/, "ws"),
};
