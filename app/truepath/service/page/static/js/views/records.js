/* Jobs and Runs that the service keeps. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { addressOf, hasEnded, machineName, statesTables } from "../flow.js";
import { card, head, kindOf, linkButton, problemNotice, shapeOf, tableFrame, wordOf } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { dateTime, day, duration, named, number, t } from "../texts.js";
import { decimalsOf, figure, quantity } from "../units.js";
import { describe as describeChange } from "./compare-card.js";
import { dropZone } from "./drop.js";
import { modelNotice } from "./model-card.js";
import { temperatureDependenceCard } from "./temperature-card.js";
import { overTimeCard } from "./trend-form.js";
import { verdictMark } from "./verdict-band.js";

/** Button that leads on. */
export function lead({ job }, { go }) {
  return { next: { key: "back", label: t("records.next"), run: () => go(addressOf(job)) } };
}

/** Show the lists. */
export function mount(root, { store, actions, go }) {
  const jobs = tableFrame(t("records.jobs"));
  const runs = tableFrame(t("records.runs"));
  const over = h("div", { class: "stack" });
  const compared = h("div", { class: "stack", "aria-live": "polite" });
  const picked = new Set();
  const filter = filterFields(() => list(store.get()));
  let errors = new Map();
  root.append(head(t("records.title"), t("records.text")), modelNotice(store.get().machine),
    h("div", { class: "stack records" }, card(t("records.jobs"), filter.element, jobs, compared), card(t("records.runs"), runs), over, temperatureDependenceCard(store),
      card(t("connect.recorded"), dropZone(store, actions))));
  actions.loadRecords().catch(actions.refuse);
  findErrors(store.get().machines).then((found) => {
    errors = found;
    list(store.get());
  }, () => {}); // the list stands without them

  function list({ jobs: all }) {
    filter.offer([...new Set(all.map(({ kind }) => kind))]);
    const shown = all.filter((job) => filter.takes(job, errors));
    jobs.replaceChildren(jobTable(shown, { go, errors, machines: store.get().machines, picked, pick, rename, isFiltered: all.length > 0 }));
  }

  async function rename({ id }, name) {
    try {
      actions.hear(await api.renameJob(id, name));
    } catch (error) {
      actions.refuse(error);
    }
  }

  /** Choose a result; of two the difference is shown, a third one takes the place of the older choice. */
  async function pick(job) {
    if (!picked.delete(job.id)) picked.add(job.id);
    if (picked.size > 2) picked.delete([...picked][0]);
    list(store.get());
    compared.replaceChildren();
    if (picked.size < 2) return;
    const asked = [...picked].join();
    const pair = store.get().jobs.filter(({ id }) => picked.has(id)).sort((a, b) => (a.created < b.created ? 1 : -1));
    const shown = await comparison(pair);
    if ([...picked].join() === asked) compared.replaceChildren(...shown);
  }

  const before = {};
  return {
    update(state) {
      if (state.jobs !== before.jobs) list(state);
      if (state.runs !== before.runs) over.replaceChildren(...[overTimeCard(state.runs, go)].filter(Boolean));
      if (state.runs !== before.runs || state.busy !== before.busy) {
        runs.replaceChildren(runTable(state, actions));
      }
      Object.assign(before, { jobs: state.jobs, runs: state.runs, busy: state.busy });
    },
    close() {},
  };
}

/** What each calibration has found, by job: the mean volumetric error in words, with its U and with what is expected after. */
async function findErrors(machines) {
  const found = await Promise.all(machines.map(({ id }) => api.machineHistory(id)));
  return new Map(found.flatMap(({ entries, calibrations }) => {
    const at = entries.findIndex(({ label }) => label === "mean");
    return calibrations.filter(({ value }) => typeof value[at] === "number").map(({ job_id, value, uncertainty, expected_after: after }) => {
      const digits = decimalsOf("error");
      const before = figure(value[at], "gap", digits);
      const measured = `${before} ± ${quantity(COVERAGE * uncertainty[at], "gap", digits)}`;
      return [job_id, { measured, change: typeof after[at] === "number" ? `${before} → ${quantity(after[at], "gap", digits)}` : measured }];
    });
  }));
}

const nameOf = (job) => job.name || [kindOf(job.kind), dateTime(job.ended ?? job.created)].join(", ");

/** What a record is called until somebody names it: machine, day and what was found and is expected after compensation, or what was done. */
const suggestedName = (job, { errors, machines }) => [machineName({ machines, machine_id: job.machine, machine: null }),
  day(job.ended ?? job.created), errors.get(job.id)?.change ?? kindOf(job.kind)].filter(Boolean).join(", ");

/** Text and kind to look for; `offer(kinds)` tells what there is, `takes(job, errors)` whether a job is shown. */
function filterFields(changed) {
  const text = h("input", { id: "record-text", type: "search", autocomplete: "off", oninput: changed });
  const kind = h("select", { id: "record-kind", onchange: changed });
  const field = (input, label) => h("div", { class: "text-field" }, h("label", { for: input.id }, label), input);
  return {
    element: h("div", { class: "filter" }, field(text, t("records.look_for")), field(kind, t("records.kind"))),
    offer(kinds) {
      const asked = kind.value;
      kind.replaceChildren(h("option", { value: "" }, t("records.all_kinds")), ...kinds.map((one) => h("option", { value: one }, kindOf(one))));
      kind.value = kinds.includes(asked) ? asked : "";
    },
    takes(job, errors) {
      const words = [nameOf(job), kindOf(job.kind), wordOf(job.state), job.machine, job.owner, errors.get(job.id)?.measured].filter(Boolean).join(" ").toLowerCase();
      return (!kind.value || job.kind === kind.value) && words.includes(text.value.trim().toLowerCase());
    },
  };
}

async function comparison([later, earlier]) {
  const title = h("h3", {}, t("records.compared", { later: nameOf(later), earlier: nameOf(earlier) }));
  try {
    const [now, then] = await Promise.all([api.result(later.id), api.result(earlier.id)]);
    return [title, describeChange(now, then)];
  } catch (error) {
    api.expectProblem(error);
    return [title, problemNotice(error)];
  }
}

const table = (titles, rows) => h("table", {},
  h("thead", {}, h("tr", {}, titles.map((title) => h("th", {}, title)),
    h("th", {}, h("span", { class: "unseen" }, t("records.actions"))))), h("tbody", {}, rows));

function jobTable(jobs, { go, errors, machines, picked, pick, rename, isFiltered }) {
  if (!jobs.length) return h("p", { class: "empty" }, t(isFiltered ? "records.none_such" : "records.no_jobs"));
  const titles = [t("records.name"), t("records.state"), t("records.kind"), t("records.created"), t("records.error"), t("records.took")];
  return table(titles, jobs.map((job) => h("tr", {},
    h("td", {}, nameField(job, suggestedName(job, { errors, machines }), rename)),
    h("td", {}, h("span", { class: "job-state" }, icon(shapeOf(job.state)), wordOf(job.state)),
      verdictMark(job)),
    h("td", {}, kindOf(job.kind)), h("td", {}, dateTime(job.created)), h("td", { class: "number" }, errors.get(job.id)?.measured ?? "–"), h("td", {}, took(job)),
    h("td", {}, h("div", { class: "row-actions" },
      statesTables(job) && h("button", { class: "button pick", "aria-pressed": String(picked.has(job.id)), onclick: () => pick(job) },
        picked.has(job.id) && icon("check"), t("records.compare")),
      h("button", { class: "button", onclick: () => go(addressOf(job)) },
        t(job.state === "succeeded" ? "records.result" : "records.open")))))));
}

/** The name, which is changed in its place. */
function nameField(job, suggested, rename) {
  const input = h("input", { class: "name-field", value: job.name ?? "", maxlength: 200, autocomplete: "off", placeholder: suggested, title: t("records.unnamed"),
    "aria-label": t("records.name_of", { kind: kindOf(job.kind), when: dateTime(job.created) }),
    disabled: document.body.dataset.role === "viewer", onchange: () => rename(job, input.value.trim()) });
  return input;
}

function took(job) {
  if (!hasEnded(job) || !job.ended) return "–";
  return duration((new Date(job.ended) - new Date(job.started ?? job.created)) / 1000);
}

/** A button that sends known lengths after a Run, and says what was kept. */
function knownLengthsButton(run, actions) {
  const file = h("input", { type: "file", accept: ".csv,text/csv", hidden: true, "aria-label": t("records.known_lengths") });
  const button = h("button", { class: "button", "data-needs": "operator", title: t("records.known_lengths_text"),
    onclick: () => file.click() }, icon("upload"), t("records.known_lengths"));
  file.addEventListener("change", async () => {
    const [chosen] = file.files;
    if (!chosen) return;
    button.disabled = true;
    try {
      const { count } = await api.sendKnownLengths(run.id, chosen);
      button.lastChild.textContent = t("records.known_lengths_kept", { count: number(count) });
    } catch (error) {
      actions.refuse(error);
    } finally {
      button.disabled = false;
      file.value = "";
    }
  });
  return [file, button];
}

function runTable({ runs, busy }, actions) {
  if (!runs.length) return h("p", { class: "empty" }, t("records.no_runs"));
  const titles = [t("records.name"), t("records.created"), t("run.samples")];
  return table(titles, runs.map((run) => h("tr", {},
    h("td", {}, named(run.name ?? "–")), h("td", {}, dateTime(run.created ?? run.started)),
    h("td", { class: "number" }, number(run.samples)),
    h("td", {}, h("div", { class: "row-actions" },
      h("button", { class: "button", "data-needs": "operator", disabled: Boolean(busy),
        onclick: () => actions.analyse(run.id) }, t("records.analyse")),
      ...knownLengthsButton(run, actions),
      linkButton(api.links.bundle(run.id), "download", t("result.bundle"), { download: `${run.id}.zip` }))))));
}
