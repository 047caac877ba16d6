/* How a machine depends on its temperature, from its calibrations: growth of axes, and what else changes. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { notice, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { wordProblem } from "../problems.js";
import { sayTemperatureRefusal } from "../statements.js";
import { nameOfAny } from "../tables.js";
import { number, t } from "../texts.js";
import { quantity } from "../units.js";

const GROWTH_UNIT = "µm/(m·K)";
const PER_KELVIN = "/K";
const NOT_TOLD = ["whole", "lost_motion", "one_temperature", "offset"];

/** The card; asks when it is told to, as the service then solves all calibrations together. */
export function temperatureDependenceCard(store) {
  const answer = h("div", { class: "stack", "aria-live": "polite" });
  const button = h("button", { class: "button", onclick: ask }, icon("records"), t("dependence.ask"));

  async function ask() {
    button.disabled = true;
    answer.replaceChildren(h("p", { class: "quiet" }, t("trend.loading")));
    try {
      answer.replaceChildren(...describe(await api.machineTemperature(store.get().machine_id)));
    } catch (error) {
      api.expectProblem(error);
      const { text, action } = wordProblem(error);
      answer.replaceChildren(notice("held", t("dependence.cannot"), sayTemperatureRefusal(error.detail ?? "") ?? text, action));
    } finally {
      button.disabled = false;
    }
  }

  return h("section", { class: "card stack", "data-card": "dependence" }, h("h2", {}, t("dependence.title")),
    h("p", { class: "quiet" }, t("dependence.text")), h("div", {}, button), answer);
}

function describe(found) {
  const { measured_degC: [low, high], calibrations, volumetric_um_per_K: volumetric, verdict } = found;
  const dependent = found.dependences.filter(({ is_significant }) => is_significant);
  const span = { low: number(low, 1), high: number(high, 1), count: number(calibrations.length) };
  return [
    verdict !== "usable" && notice("held", t("dependence.doubtful"), t("dependence.doubtful_text")),
    h("p", {}, h("strong", {}, t(dependent.length ? "dependence.found" : "dependence.none", { ...span, symbols: dependent.map(({ symbol }) => symbol).join(", ") }))),
    h("p", {}, t("dependence.volumetric", { value: quantity(volumetric.value, "gap") + PER_KELVIN,
      u: quantity(COVERAGE * volumetric.uncertainty, "gap") + PER_KELVIN, k: COVERAGE })),
    growthTable(found.expansion), dependenceTable(found),
    h("p", { class: "quiet" }, t("dependence.note", { reference: number(found.reference_degC) })),
    h("details", {}, h("summary", {}, t("trend.not_told")), h("ul", { class: "lines" }, NOT_TOLD.map((key) => h("li", {}, t(`dependence.not_told.${key}`))))),
  ].filter(Boolean);
}

const answered = (isSure) => t(isSure ? "dependence.yes" : "dependence.no");

function growthTable(expansion) {
  const rows = Object.entries(expansion).map(([axis, one]) => h("tr", { "data-axis": axis }, h("th", { scope: "row" }, axis),
    h("td", { class: "right" }, `${number(one.value_um_per_m_K, 1)} ± ${number(COVERAGE * one.uncertainty_um_per_m_K, 1)} ${GROWTH_UNIT}`),
    h("td", {}, answered(one.is_significant))));
  return table(t("dependence.growth"), [t("dependence.axis"), t("dependence.per_kelvin", { k: COVERAGE }), t("dependence.sure")], rows);
}

function dependenceTable({ dependences, coefficients }) {
  const rows = [...dependences].sort((a, b) => b.is_significant - a.is_significant || a.chance - b.chance).map(({ symbol, is_significant: isSure }) =>
    h("tr", { "data-symbol": symbol }, h("th", { scope: "row" }, h("span", { class: "symbol" }, symbol), " ", h("span", { class: "quiet" }, nameOfAny(symbol))),
      h("td", { class: "right" }, largest(coefficients[symbol])), h("td", {}, answered(isSure))));
  return table(t("dependence.errors"), [t("result.symbol"), t("dependence.largest", { k: COVERAGE }), t("dependence.sure")], rows);
}

/** The largest change per kelvin with its expanded uncertainty. */
function largest(one) {
  if (!one) return "–";
  const kind = one.value_um_per_K === undefined || one.value_um_per_K === null ? "angle" : "error";
  const [values, uncertainties] = (kind === "angle" ? [one.value_urad_per_K, one.uncertainty_urad_per_K]
    : [one.value_um_per_K, one.uncertainty_um_per_K]).map((column) => [column].flat());
  const at = values.reduce((best, v, i) => (Math.abs(v) > Math.abs(values[best]) ? i : best), 0);
  return `${quantity(values[at], kind)}${PER_KELVIN} ± ${quantity(COVERAGE * uncertainties[at], kind)}${PER_KELVIN}`;
}

const table = (name, titles, rows) => h("div", {}, h("h3", {}, name), tableFrame(name, h("table", {},
  h("thead", {}, h("tr", {}, titles.map((title, i) => h("th", i === 1 ? { class: "right" } : {}, title)))), h("tbody", {}, rows))));
