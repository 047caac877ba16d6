/* A result beside an earlier calibration of the same machine: what has changed by more than both know. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { kindOf, notice, problemNotice, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { singleErrors, tablesByAxis } from "../tables.js";
import { dateTime, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { showTable } from "./table-sheet.js";

/** The card; null where there is no other result. `onOther(job, result)` hears of one that can be compared. */
export function compareCard(job, result, jobs, onOther) {
  const others = jobs.filter((other) => other.id !== job.id && other.result && other.state === "succeeded");
  if (!others.length) return null;
  const content = h("div", { class: "stack", "aria-live": "polite" });
  let asked = "";
  const choice = h("select", { id: "compare-with", onchange: () => choose(choice.value) },
    h("option", { value: "" }, t("compare.none")),
    others.map((other) => h("option", { value: other.id }, `${dateTime(other.ended ?? other.created)} · ${kindOf(other.kind)}`)));

  async function choose(id) {
    asked = id;
    content.replaceChildren();
    if (!id) return;
    let shown;
    try {
      const found = await api.result(id);
      shown = describe(result, found);
      if (!difference(result, found)) onOther(others.find((other) => other.id === id), found);
    } catch (error) {
      api.expectProblem(error);
      shown = problemNotice(error);
    }
    if (asked === id) content.replaceChildren(shown);
  }

  return h("section", { class: "card stack", "data-card": "compare" }, h("h2", {}, t("compare.title")),
    h("div", { class: "field" }, h("label", { for: "compare-with" }, t("compare.with")), choice), content);
}

/** What has changed from one result to a later one, as elements; or why that cannot be said. */
export function describe(now, then) {
  const reason = difference(now, then);
  if (reason) return notice("held", t("compare.not_alike"), reason);
  const rows = [...tableRows(now, then), ...singleRows(now, then)].sort((a, b) => b.ratio - a.ratio);
  const beyond = rows.filter((row) => row.ratio > 1).length;
  return h("div", { class: "stack" },
    h("p", {}, t(beyond ? "compare.changed" : "compare.same", { count: number(beyond), total: number(rows.length), k: COVERAGE })),
    tableFrame(t("compare.title"), h("table", { class: "compare" },
      h("thead", {}, h("tr", {}, h("th", {}, t("result.symbol")), h("th", { class: "right" }, t("compare.change")),
        h("th", { class: "right" }, t("compare.u", { k: COVERAGE })), h("th", { class: "right" }, t("compare.at")), h("th", {}, ""))),
      h("tbody", {}, rows.map(row)))),
    h("p", { class: "quiet" }, t("compare.note")));
}

/** Why two results cannot be held against each other; empty where they can. */
function difference(now, then) {
  const of = ({ machine }) => JSON.stringify([machine.kinematic_chain, machine.axes]);
  if (now.machine.name !== then.machine.name || of(now) !== of(then)) return t("compare.other_machine", { name: then.machine.name });
  const tool = ({ machine }) => JSON.stringify([machine.tool_offset_mm ?? null, machine.targets ?? null]);
  return tool(now) === tool(then) ? "" : t("compare.other_tool");
}

function tableRows(now, then) {
  const before = new Map(tablesByAxis(then).flatMap(({ tables }) => tables).filter((table) => table.known).map((table) => [table.symbol, table]));
  return tablesByAxis(now).flatMap(({ tables }) => tables).filter((table) => table.known && before.has(table.symbol)).map((table) => {
    const changed = subtract(table, before.get(table.symbol));
    const ratios = changed.values.map((v, i) => Math.abs(v) / (COVERAGE * changed.uncertainties[i] || Infinity));
    const at = ratios.indexOf(Math.max(...ratios));
    return { symbol: table.symbol, name: table.name, kind: table.kind, ratio: ratios[at], change: changed.values[at],
      uncertainty: changed.uncertainties[at], place: `${table.axis} ${quantity(table.positions[at], table.positionKind)}`, table: changed };
  });
}

/** A table less an earlier one, at its own positions. */
function subtract(now, then) {
  const at = (column) => now.positions.map((position) => interpolate(position, then.positions, column));
  const [values, uncertainties] = [at(then.values), at(then.uncertainties)];
  return { ...now, name: `${now.name} · ${t("compare.change")}`, halves: null,
    values: now.values.map((v, i) => v - values[i]), uncertainties: now.uncertainties.map((u, i) => Math.hypot(u, uncertainties[i])) };
}

function interpolate(position, positions, column) {
  const next = positions.findIndex((p) => p >= position);
  if (next <= 0) return column[next < 0 ? column.length - 1 : 0];
  const share = (position - positions[next - 1]) / (positions[next] - positions[next - 1]);
  return column[next - 1] + share * (column[next] - column[next - 1]);
}

function singleRows(now, then) {
  const before = new Map(singleErrors(then).map((one) => [one.symbol, one]));
  return singleErrors(now).filter(({ symbol }) => before.has(symbol)).map(({ symbol, name, kind, value, uncertainty }) => {
    const other = before.get(symbol);
    const u = Math.hypot(uncertainty ?? 0, other.uncertainty ?? 0);
    return { symbol, name, kind, change: value - other.value, uncertainty: u, ratio: Math.abs(value - other.value) / (COVERAGE * u || Infinity), place: "–", table: null };
  });
}

function row({ symbol, name, kind, change, uncertainty, ratio, place, table }) {
  return h("tr", { "data-changed": ratio > 1 }, h("td", {}, h("span", { class: "symbol" }, symbol), " ", h("span", { class: "quiet" }, name)),
    h("td", { class: "right" }, quantity(change, kind)), h("td", { class: "right" }, `± ${quantity(COVERAGE * uncertainty, kind)}`),
    h("td", { class: "right" }, place),
    h("td", { class: "right" }, ratio > 1 && h("span", { class: "changed" }, icon("warning"), t("compare.beyond")),
      table && h("button", { class: "button is-plain", "aria-label": t("result.enlarge", { symbol }), onclick: () => showTable(table) }, icon("expand"))));
}
