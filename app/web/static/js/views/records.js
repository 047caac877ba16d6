/* Jobs and Runs that the service keeps. */
import { links } from "../api.js";
import { h, icon } from "../dom.js";
import { addressOf, hasEnded } from "../flow.js";
import { card, head, kindOf, linkButton, shapeOf, wordOf } from "../parts.js";
import { dateTime, duration, number, t } from "../texts.js";
import { dropZone } from "./drop.js";
import { modelNotice } from "./model-card.js";
import { overTimeCard } from "./trend-form.js";
import { verdictMark } from "./verdict-band.js";

/** Button that leads on. */
export function lead({ job }, { go }) {
  return { next: { key: "back", label: t("records.next"), run: () => go(addressOf(job)) } };
}

/** Show the lists. */
export function mount(root, { store, actions, go }) {
  const jobs = h("div", { class: "table-scroll" });
  const runs = h("div", { class: "table-scroll" });
  const over = h("div", { class: "stack" });
  root.append(head(t("records.title"), t("records.text")), modelNotice(store.get().machine),
    h("div", { class: "stack records" }, card(t("records.jobs"), jobs), card(t("records.runs"), runs), over,
      card(t("connect.recorded"), dropZone(store, actions))));
  actions.loadRecords().catch(actions.refuse);
  const before = {};
  return {
    update(state) {
      if (state.jobs !== before.jobs) jobs.replaceChildren(jobTable(state.jobs, go));
      if (state.runs !== before.runs) over.replaceChildren(...[overTimeCard(state.runs, go)].filter(Boolean));
      if (state.runs !== before.runs || state.busy !== before.busy) {
        runs.replaceChildren(runTable(state, actions));
      }
      Object.assign(before, { jobs: state.jobs, runs: state.runs, busy: state.busy });
    },
    close() {},
  };
}

const table = (titles, rows) => h("table", {},
  h("thead", {}, h("tr", {}, titles.map((title) => h("th", {}, title)),
    h("th", {}, h("span", { class: "unseen" }, t("records.actions"))))), h("tbody", {}, rows));

function jobTable(jobs, go) {
  if (!jobs.length) return h("p", { class: "empty" }, t("records.no_jobs"));
  const titles = [t("records.state"), t("records.kind"), t("records.created"), t("records.took")];
  return table(titles, jobs.map((job) => h("tr", {},
    h("td", {}, h("span", { class: "job-state" }, icon(shapeOf(job.state)), wordOf(job.state)),
      verdictMark(job)),
    h("td", {}, kindOf(job.kind)), h("td", {}, dateTime(job.created)), h("td", {}, took(job)),
    h("td", {}, h("div", { class: "row-actions" },
      h("button", { class: "button", type: "button", onclick: () => go(addressOf(job)) },
        t(job.state === "succeeded" ? "records.result" : "records.open")))))));
}

function took(job) {
  if (!hasEnded(job) || !job.ended) return "–";
  return duration((new Date(job.ended) - new Date(job.started ?? job.created)) / 1000);
}

function runTable({ runs, busy }, actions) {
  if (!runs.length) return h("p", { class: "empty" }, t("records.no_runs"));
  const titles = [t("records.name"), t("records.created"), t("run.samples")];
  return table(titles, runs.map((run) => h("tr", {},
    h("td", {}, run.name ?? run.id), h("td", {}, dateTime(run.created ?? run.started)),
    h("td", { class: "number" }, number(run.samples)),
    h("td", {}, h("div", { class: "row-actions" },
      h("button", { class: "button", type: "button", "data-needs": "operator", disabled: Boolean(busy),
        onclick: () => actions.analyse(run.id) }, t("records.analyse")),
      linkButton(links.bundle(run.id), "download", t("result.bundle"), { download: `${run.id}.zip` }))))));
}
