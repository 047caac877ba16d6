/* A machine over its calibrations: how far off each has found it. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { card, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { dateTime, t } from "../texts.js";
import { decimalsOf, figure, quantity } from "../units.js";

const LABELS = ["mean", "p95", "largest"];
const SHOWN = 12;

/** The volumetric error that a calibration states, by label, with its U (k = 2), in words; "–" where it states none. */
export function wordEntry({ entries }, { value, uncertainty }, label) {
  const at = entries.findIndex((entry) => entry.label === label);
  if (at < 0 || typeof value[at] !== "number") return "–";
  const digits = decimalsOf("error");
  const u = typeof uncertainty[at] === "number" ? quantity(COVERAGE * uncertainty[at], "gap", digits) : "–";
  return `${figure(value[at], "gap", digits)} ± ${u}`;
}

/** The card, the newest calibration first; hidden until there is another one than this job's; null where no machine is known. */
export function historyCard(job, machine_id) {
  if (!machine_id) return null;
  const content = h("div");
  const element = card(t("history.title"), h("p", { class: "quiet" }, t("history.text", { k: COVERAGE })), content);
  Object.assign(element, { hidden: true }).dataset.card = "history";
  // The result stands without it.
  api.machineHistory(machine_id).then((history) => {
    const newest = [...history.calibrations].reverse().slice(0, SHOWN);
    if (!newest.some(({ job_id }) => job_id !== job.id)) return;
    content.replaceChildren(table(newest, history, job));
    element.hidden = false;
  }, () => {});
  return element;
}

const table = (calibrations, history, job) => tableFrame(t("history.title"), h("table", {},
  h("thead", {}, h("tr", {}, h("th", {}, t("history.measured")), LABELS.map((label) => h("th", { class: "right" }, t(`verify.${label}`))))),
  h("tbody", {}, calibrations.map((one) => h("tr", { "aria-current": one.job_id === job.id ? "true" : null },
    h("td", {}, one.job_id === job.id ? h("b", {}, t("history.this", { when: dateTime(one.measured) }))
      : h("a", { href: `#/result/${one.job_id}` }, dateTime(one.measured)),
    one.verdict === "not-usable" && h("span", { class: "quiet" }, ` ${t("history.not_usable")}`)),
    LABELS.map((label) => h("td", { class: "right" }, wordEntry(history, one, label))))))));
