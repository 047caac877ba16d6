/* Where the uncertainty of the volume comes from: shares of its square, by source. */
import { h } from "../dom.js";
import { card, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { known, number, t } from "../texts.js";
import { figure, unitOf } from "../units.js";

const COLUMNS = ["volume", "x", "y", "z"];

/** The card; null where the result has no budget. */
export function budgetCard({ uncertainty_budget: budget }) {
  if (!budget) return null;
  const { sources_um: sources, total_um: total } = budget;
  const share = ({ volume }) => (100 * volume ** 2) / (total.volume ** 2 || 1);
  const rows = Object.entries(sources).filter(([, parts]) => parts.volume > 0).sort((a, b) => b[1].volume - a[1].volume);
  const micro = unitOf("gap");
  const title = (text) => h("th", { class: "right", scope: "col" }, text);
  const cells = (parts) => COLUMNS.map((name) => h("td", { class: "right" }, figure(COVERAGE * parts[name], "gap")));
  const element = card(t("budget.title"),
    h("p", { class: "quiet" }, t("budget.text", { k: COVERAGE, unit: micro })),
    tableFrame(t("budget.title"), h("table", { class: "budget" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("budget.source")), h("th", { scope: "col" }, t("budget.share")),
        title(t("budget.volume")), ["X", "Y", "Z"].map(title))),
      h("tbody", {}, rows.map(([source, parts]) => h("tr", { "data-source": source }, h("td", {}, known(`budget.${source}`, source)),
        h("td", { class: "budget-share" }, h("i", { style: `width:${share(parts)}%` }), h("span", {}, `${number(share(parts), share(parts) < 10 ? 1 : 0)} %`)),
        cells(parts))), h("tr", { class: "budget-total" }, h("td", {}, t("budget.total")), h("td", {}, ""), cells(total))))));
  element.dataset.card = "budget";
  return element;
}
