/* What is known of the machine while it moves: tables that tighten, the uncertainty over time. */
import { h, mark, write } from "../dom.js";
import { isMoving } from "../flow.js";
import { segments, tableFrame } from "../parts.js";
import { colour } from "../plots/css-colour.js";
import { COVERAGE, drawErrors, reachOf, roundReach } from "../plots/error-chart.js";
import { axisStyle, drawFilling, drawLevel } from "../plots/filling-chart.js";
import { singleErrors, tablesByAxis } from "../tables.js";
import { clock, duration, number, t } from "../texts.js";
import { figure, quantity, shown, unitOf } from "../units.js";

let chosenAxis = null;

/** A card that follows the live estimate; `show(visible)` draws or rests, `update(state)`. */
export function estimateCard() {
  const tools = h("div", { class: "estimate-tools" });
  const stamp = h("p", { class: "stamp is-stale", role: "status", hidden: true });
  const age = h("p", { class: "quiet number estimate-age" });
  const waiting = h("p", { class: "empty" }, t("estimate.waiting"));
  const course = courseFigure();
  const singles = tableFrame(t("result.squareness"));
  singles.classList.add("estimate-singles");
  const grid = h("div", { class: "charts is-live", role: "group" });
  const content = h("div", { class: "estimate-content", hidden: true },
    h("div", { class: "estimate-top" }, course.element, singles), grid);
  const element = h("section", { class: "card estimate-card", "aria-label": t("estimate.title"), hidden: true },
    tools, h("div", { class: "estimate-head" }, age, stamp), waiting, content);
  let charts = new Map();
  let axes = "";
  let drawn = null;
  let state = null;

  function close() {
    for (const chart of charts.values()) chart.close();
    charts = new Map();
    course.close();
  }

  function update(next) {
    state = next;
    if (element.hidden) return;
    const { estimate, job, estimateStale, machine } = state;
    chooseAmong(Object.keys(machine?.axes ?? {}));
    waiting.hidden = Boolean(estimate);
    content.hidden = !estimate;
    write(waiting, isMoving(job) ? t("estimate.waiting") : t("estimate.none"));
    stamp.hidden = !estimateStale;
    write(stamp, estimateStale ? t("estimate.stale", { since: clock(estimateStale) }) : "");
    content.classList.toggle("is-stale-data", Boolean(estimateStale) || estimate?.verdict?.state === "not-usable");
    write(age, estimate ? ageText(estimate, job) : "");
    if (!estimate || estimate === drawn) return;
    drawn = estimate;
    course.update(state);
    draw();
  }

  function draw() {
    const groups = tablesByAxis({ machine: state.machine, error_tables: state.estimate.error_tables });
    mark(grid, "aria-label", t("result.axis", { axis: chosenAxis }));
    const { tables } = groups.find((group) => group.axis === chosenAxis);
    fillCharts(tables);
    singles.replaceChildren(singleList(singleErrors(state.estimate)));
  }

  function chooseAmong(names) {
    if (axes === names.join()) return;
    axes = names.join();
    if (!names.includes(chosenAxis)) [chosenAxis] = names;
    tools.replaceChildren(segments(t("estimate.axis"),
      names.map((name) => [name, t("result.axis", { axis: name })]), chosenAxis, (name) => {
        chosenAxis = name;
        if (state.estimate) draw();
      }, true));
  }

  function fillCharts(tables) {
    const scales = { error: reachIn(tables, "error"), angle: reachIn(tables, "angle") };
    const key = tables.map((table) => `${table.symbol}${table.known}`).join();
    if (grid.dataset.key !== key) {
      grid.dataset.key = key;
      for (const chart of charts.values()) chart.close();
      const cards = tables.map(liveChart);
      grid.replaceChildren(...cards.map((card) => card.element));
      charts = new Map(cards.map((card, i) => [tables[i].symbol, card]));
    }
    for (const table of tables) charts.get(table.symbol).update(table, scales[table.kind]);
  }

  return {
    element, update, close,
    show(visible) {
      element.hidden = !visible;
      drawn = null;
      if (state) update(state);
    },
  };
}

/** One round scale for all tables of a kind on an axis: steps show that they tighten. */
function reachIn(tables, kind) {
  const reaches = tables.filter((table) => table.known && table.kind === kind).map(reachOf);
  return roundReach(Math.max(0, ...reaches));
}

function liveChart({ symbol, name, kind, known: isKnown }) {
  const u = h("strong", { class: "number" });
  const plot = isKnown ? h("div", { class: "chart-plot", role: "img" })
    : h("div", { class: "chart-missing" }, h("p", {}, t("result.unknown")));
  const element = h("article", { class: `chart${isKnown ? "" : " is-missing"}`, "data-symbol": symbol },
    h("header", {}, h("h3", {}, symbol, h("span", { class: "unit" }, unitOf(kind)), h("small", {}, name)), u), plot);
  let chart = null;
  return {
    element,
    update(table, reach) {
      if (!table.known) return;
      const largest = Math.max(...table.uncertainties.map((v) => COVERAGE * v));
      write(u, `± ${figure(largest, kind)}`);
      mark(plot, "aria-label", t("estimate.chart", {
        symbol, name, k: COVERAGE, u: quantity(largest, kind),
        least: figure(Math.min(...table.values), kind), most: quantity(Math.max(...table.values), kind) }));
      if (chart) chart.update(table, reach);
      else chart = drawErrors(plot, table, { reach });
    },
    close() {
      chart?.close();
    },
  };
}

function singleList(rows) {
  const u = (text) => h("th", { class: "right" }, text);
  return h("table", {},
    h("thead", {}, h("tr", {}, h("th", {}, t("result.squareness")), u(`± U (k = ${COVERAGE})`))),
    h("tbody", {}, rows.map(({ symbol, name, kind, value, uncertainty }) =>
      h("tr", {}, h("th", { class: "symbol", scope: "row", title: name }, symbol),
        h("td", { class: "right" },
          `${figure(value, kind)} ± ${quantity(COVERAGE * uncertainty, kind)}`)))));
}

function courseFigure() {
  const plot = h("div", { class: "course-plot", role: "img" });
  const target = h("span", { class: "course-target" });
  const title = t("estimate.course_title", { k: COVERAGE, unit: unitOf("error") });
  const element = h("figure", { class: "course" }, h("figcaption", {}, h("span", {}, title), target), plot);
  let chart = null;
  return {
    element,
    update({ estimate, course, job }) {
      const target_um = job.target_um ?? null;
      const values = {
        k: COVERAGE, u: quantity(COVERAGE * estimate.volumetric_uncertainty_um, "error"),
        target: target_um === null ? "" : quantity(COVERAGE * target_um, "error"),
      };
      mark(plot, "aria-label", t(target_um === null ? "estimate.course" : "estimate.course_target", values));
      target.hidden = target_um === null;
      write(target, t("estimate.target", values));
      chart ??= drawCourse(plot);
      chart.update(course, target_um);
    },
    close() {
      chart?.close();
      chart = null;
    },
  };
}

function ageText({ done, total, age_s }, job) {
  const unit = t(job.kind === "measure-standstill" ? "unit.points" : "unit.lines");
  const values = { done: number(done), total: number(total), unit, age: number(Math.floor(age_s)) };
  return t(isMoving(job) ? "estimate.age" : "estimate.last", values);
}

const SHORTEST_S = 30;

/** Draw the course on a logarithmic scale; answers {update(course, target_um), close}.
 *
 * course: columns elapsed_s and volumetric_uncertainty_um (k = 1); target_um: k = 1, or null
 */
function drawCourse(element) {
  const drawn = { target: null };
  const { chart, close } = drawFilling(element, [[], []], options(drawn));
  return {
    update({ elapsed_s, volumetric_uncertainty_um }, target_um) {
      drawn.target = target_um === null ? null : expanded(target_um);
      chart.setData([elapsed_s, volumetric_uncertainty_um.map(expanded)]);
    },
    close,
  };
}

const expanded = (um) => COVERAGE * shown(um, "error");

function options(drawn) {
  const common = axisStyle();
  return {
    padding: [8, 14, 0, 0],
    scales: {
      x: { time: false, range: (_, low, high) => [0, Math.max(high ?? 0, SHORTEST_S)] },
      y: { distr: 3, range: (chart) => spread([...chart.data[1], drawn.target]) },
    },
    axes: [
      { ...common, size: 26, space: 56, grid: { show: false },
        values: (_, marks) => marks.map(duration) },
      { ...common, size: 48, space: 22, grid: { stroke: colour("line"), width: 1 },
        splits: (_chart, _axis, low, high) => roundMarks(low, high),
        // Where room is short a mark comes as null: a line without a number.
        values: (_, marks) => marks.map((m) => (m === null ? "" : number(m, decimalsOf(m)))) },
    ],
    series: [{}, { stroke: colour("accent"), width: 2.25, pxAlign: 0,
      points: { show: true, size: 6, fill: colour("accent") } }],
    hooks: { draw: [(chart) => drawLevel(chart, drawn.target)] },
  };
}

/** Limits that hold all values, a little apart; a decade where there is none yet. */
function spread(values) {
  const positive = values.filter((v) => v > 0);
  if (!positive.length) return [1, 10];
  return [Math.min(...positive) / 1.5, Math.max(...positive) * 1.5];
}

/** 1, 2, 5, 10, … between limits; only powers of ten over many decades. */
function roundMarks(low, high) {
  const steps = Math.log10(high / low) > 2.2 ? [1] : [1, 2, 5];
  const first = Math.floor(Math.log10(low));
  const decades = Array.from({ length: Math.ceil(Math.log10(high)) - first + 1 }, (_, i) => 10 ** (first + i));
  return decades.flatMap((decade) => steps.map((step) => step * decade)).filter((m) => m >= low && m <= high);
}

const decimalsOf = (mark) => Math.max(0, -Math.floor(Math.log10(mark) + 1e-9));
