/* One error motion large, with its numbers. */
import { h } from "../dom.js";
import { COVERAGE, columns, drawErrors } from "../plots/error-chart.js";
import { openSheet, sheetHead } from "../sheets.js";
import { number, t } from "../texts.js";
import { decimalsOf, unitOf } from "../units.js";

/** Open the sheet with a table's plot and values. */
export function showTable(table) {
  const sheet = document.getElementById("detail");
  const plot = h("div", { class: "chart-plot" });
  const read = h("p", { class: "chart-read" });
  const title = `${table.symbol} · ${table.name}`;
  sheet.replaceChildren(sheetHead(sheet, title), plot, read, values(table));
  openSheet(sheet);
  const chart = drawErrors(plot, table, { read: (text) => { read.textContent = text; } });
  sheet.addEventListener("close", () => chart.close(), { once: true });
}

function values(table) {
  const { x, value, expanded, up, down } = columns(table);
  const digits = decimalsOf(table.kind);
  const unit = unitOf(table.kind);
  const rows = x.map((position, i) => h("tr", {},
    h("td", { class: "right" }, number(position, decimalsOf(table.positionKind)), table.extrapolated[i] && "*"),
    h("td", { class: "right" }, number(value[i], digits)),
    h("td", { class: "right" }, `± ${number(expanded[i], digits)}`),
    [up, down].filter(Boolean).map((way) => h("td", { class: "right" }, number(way[i], digits)))));
  const title = (text) => h("th", { class: "right" }, text);
  return h("div", { class: "detail-table", tabindex: "0" }, h("table", {},
    h("thead", {}, h("tr", {}, title(`${table.axis} (${unitOf(table.positionKind)})`),
      title(t("result.value_in", { unit })), title(t("result.u_in", { unit, k: COVERAGE })),
      up && [title(t("result.up_in", { unit })), title(t("result.down_in", { unit }))])),
    h("tbody", {}, rows),
    table.extrapolated.some(Boolean) && h("caption", {}, t("result.extrapolated"))));
}
