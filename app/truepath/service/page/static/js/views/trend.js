/* The machine over time: how far it is off, its entries, and when to calibrate again. */
import { links } from "../api.js";
import { h } from "../dom.js";
import { place } from "../flow.js";
import { card, head, linkButton, notice, segments, tableFrame } from "../parts.js";
import { colour } from "../plots/css-colour.js";
import { COVERAGE, decimalsFor } from "../plots/error-chart.js";
import { axisStyle, drawFilling, drawLevel } from "../plots/filling-chart.js";
import { nameOf, singleErrors } from "../tables.js";
import { named, number, t } from "../texts.js";
import { quantity, shown, unitOf } from "../units.js";
import { temperatureDependenceCard } from "./temperature-card.js";
import { trendForm } from "./trend-form.js";
import { verdictBand } from "./verdict-band.js";

const FEW = 6;
const UM_PER_URAD = 0.5; // an angle of 2 µrad counts as 1 µm
let form = null;

/** Button that leads on. */
export function lead(state, { actions, go }) {
  const back = { label: t("trend.back"), run: () => go("#/records") };
  if (!place(location.hash).id) return { back, ...(form?.lead(state, actions) ?? { next: null }) };
  return { back, next: { key: "again", label: t("trend.again"), run: () => go("#/trend") } };
}

/** Show the form, or what a job has found. */
export function mount(root, { store, actions }) {
  root.append(head(t("trend.title"), t("trend.text")));
  const body = h("div", { class: "stack trend" });
  root.append(body);
  form = null;
  if (!place(location.hash).id) {
    form = trendForm(store);
    body.append(form.element, temperatureDependenceCard(store));
    actions.loadRecords().catch(actions.refuse);
    return { update: form.update, close() {} };
  }
  let charts = [];
  let drawn = null;
  body.append(h("p", { class: "empty" }, t("trend.loading")));
  const close = () => charts.splice(0).forEach((chart) => chart.close());
  return {
    update({ job, trend }) {
      if (!trend || trend === drawn) return;
      drawn = trend;
      close();
      const band = verdictBand(trend.verdict);
      body.replaceChildren(outlookCard(trend.outlook), ...(band ? [band] : []), downloads(job));
      charts = [drawVolumetric(body, trend), ...drawEntries(body, trend)];
      body.append(runsCard(trend), notTold());
    },
    close,
  };
}

/** When to calibrate again, in the language of the page. */
export function sentence(outlook) {
  if (outlook.limit_um === null && outlook.state !== "not-known") return t("trend.no_limit");
  const hours = (value) => `${number(value, value < 10 ? 1 : 0)} h`;
  const values = {
    limit: quantity(outlook.limit_um, "error"), end: hours(outlook.time_h.at(-1)),
    due: outlook.due_h === null ? "" : hours(outlook.due_h),
    expected: outlook.expected_h === null ? "" : hours(outlook.expected_h),
    chance: number(100 * outlook.chance), exceeded: number(100 * (outlook.exceeded ?? 0)),
    from: hours(outlook.time_h[0]),
  };
  return t(`trend.outlook.${outlook.state}`, values);
}

function outlookCard(outlook) {
  const grade = outlook.grade && t(`trend.sure.${outlook.grade}`);
  const tone = { due: "held", already: "held", "cannot-be-said": "held" }[outlook.state] ?? null;
  const shown = notice(tone, t(`trend.answer.${outlook.state}`), sentence(outlook), grade && t("trend.grade", { grade }));
  shown.dataset.state = outlook.state;
  return shown;
}

function downloads({ id }) {
  return h("div", { class: "downloads", role: "group", "aria-label": t("result.downloads") },
    linkButton(links.trendReport(id), "report", t("result.report"), { target: "_blank", rel: "noopener" }),
    linkButton(links.trend(id), "download", "JSON", { download: `trend-${id}.json` }));
}

const um = (value) => shown(value, "error");

function drawVolumetric(body, { runs, outlook }) {
  const plot = h("div", { class: "chart-plot is-high", role: "img", "aria-label": t("trend.volumetric") });
  body.append(card(t("trend.volumetric"), h("p", { class: "quiet" }, t("trend.volumetric_text", { unit: unitOf("error") })),
    legend(outlook.limit_um), plot));
  const of = (name) => runs.map((run) => um(run.change_um[name]));
  return drawOverTime(plot, {
    measured: { hours: runs.map((run) => run.time_h), value: of("median"), low: of("low"), high: of("high") },
    predicted: { hours: outlook.time_h, value: outlook.median_um.map(um),
      low: outlook.time_h.map(() => 0), high: outlook.high_um.map(um) },
    limit: outlook.limit_um === null ? null : um(outlook.limit_um), floor: 0,
  });
}

const legend = (limit) => h("ul", { class: "key" }, h("li", {}, h("i"), t("trend.measured")),
  h("li", { class: "is-up is-dashed" }, h("i"), t("trend.predicted")), h("li", { class: "is-band" }, h("i"), t("trend.band")),
  limit !== null && h("li", { class: "is-limit" }, h("i"), t("trend.limit")));

function drawEntries(body, trend) {
  const entries = entriesOf(trend);
  const grid = h("div", { class: "charts" });
  const charts = [];
  const choice = segments(t("trend.entries"), [["few", t("trend.few")], ["all", t("trend.all")]], "few", fill);
  body.append(h("div", { class: "result-bar" }, h("h2", {}, t("trend.entries")), choice), grid);
  fill("few");
  return [{ close: () => charts.splice(0).forEach((chart) => chart.close()) }];

  function fill(which) {
    charts.splice(0).forEach((chart) => chart.close());
    grid.replaceChildren();
    for (const entry of which === "few" ? entries.slice(0, FEW) : entries) {
      const plot = h("div", { class: "chart-plot", role: "img", "aria-label": entry.symbol });
      grid.append(h("article", { class: "chart", "data-symbol": entry.symbol }, h("header", {},
        h("h3", {}, entry.symbol, h("span", { class: "unit" }, unitOf(entry.kind)), h("small", {}, entry.name))),
      plot, h("p", { class: "chart-read" }, entry.read)));
      charts.push(drawOverTime(plot, entry));
    }
  }
}

/** Every table where it changes most, and the numbers, what changes most first. */
function entriesOf({ runs, later }) {
  const tables = Object.keys(runs[0].error_tables).map((symbol) => {
    const columns = [...runs, ...later].map((at) => at.error_tables[symbol]);
    const kind = columns[0].value_um ? "error" : "angle";
    const [value, sigma] = kind === "error" ? ["value_um", "uncertainty_um"] : ["value_urad", "uncertainty_urad"];
    const known = columns.map((column) => column[value]);
    const spread = known[0].map((_, i) => Math.max(...known.map((v) => v[i])) - Math.min(...known.map((v) => v[i])));
    const i = spread.indexOf(Math.max(...spread));
    const [position, unit] = columns[0].position_mm ? [columns[0].position_mm[i], "travel"] : [columns[0].position_deg[i], "turn"];
    const name = `${nameOf(symbol)}, ${symbol[2]} = ${quantity(position, unit, 0)}`;
    return entry(symbol, name, kind, known.map((v) => v[i]), columns.map((column) => column[sigma][i]));
  });
  const each = [...runs, ...later].map(singleErrors);
  const numbers = each[0].map(({ symbol, name, kind }, i) =>
    entry(symbol, name, kind, each.map((all) => all[i].value), each.map((all) => all[i].uncertainty)));
  return [...tables, ...numbers].sort((a, b) => b.change - a.change);

  function entry(symbol, name, kind, values, sigmas) {
    const part = (at, from, to) => {
      const [own, spread] = [values.slice(from, to), sigmas.slice(from, to).map((s) => COVERAGE * s)];
      const side = (sign) => own.map((v, i) => shown(v + sign * spread[i], kind));
      return { hours: at.map((one) => one.time_h), value: side(0), low: side(-1), high: side(1) };
    };
    const count = runs.length;
    const change = (Math.max(...values) - Math.min(...values)) * (kind === "error" ? 1 : UM_PER_URAD);
    const predicted = part([runs.at(-1), ...later], count - 1);
    const read = t("trend.from_to", { from: quantity(values[0], kind), to: quantity(values[count - 1], kind),
      u: quantity(COVERAGE * sigmas[count - 1], kind), k: COVERAGE });
    return { symbol, name, kind, change, measured: part(runs, 0, count), predicted, read };
  }
}

function runsCard({ runs, later }) {
  const row = (at) => h("tr", {}, h("td", {}, at.name ? named(at.name) : t("trend.predicted")),
    h("td", { class: "right" }, number(at.time_h, 2)), h("td", { class: "right" }, quantity(at.change_um.median, "error")),
    h("td", { class: "right" }, quantity(at.change_um.high, "error")));
  const titles = [t("trend.run"), t("trend.hours"), t("trend.off"), t("trend.off_high")];
  return card(t("trend.runs"), tableFrame(t("trend.runs"), h("table", {},
    h("thead", {}, h("tr", {}, titles.map((title, i) => h("th", i ? { class: "right" } : {}, title)))),
    h("tbody", {}, [...runs, ...later].map(row)))));
}

const notTold = () => card(t("trend.not_told"), h("ul", { class: "lines" },
  ["volume", "within", "direction", "begun"].map((key) => h("li", {}, t(`trend.not_told.${key}`)))));

/** Draw a chart; answers {close}.
 *
 * measured, predicted: {hours, value, low, high}, in shown units; limit: of the quantity, or null
 * floor: lowest value drawn, or null for where the values end
 */
function drawOverTime(element, { measured, predicted, limit = null, floor = null }) {
  const data = rows(measured, predicted);
  return drawFilling(element, data, options(data, limit, floor));
}

/** One column of hours; values where there are some, else null. */
function rows(measured, predicted) {
  const hours = [...measured.hours, ...predicted.hours];
  const first = ({ hours: own }, values) => [...values, ...Array(hours.length - own.length).fill(null)];
  const last = ({ hours: own }, values) => [...Array(hours.length - own.length).fill(null), ...values];
  const parts = ["value", "low", "high"];
  return [hours, ...parts.map((part) => first(measured, measured[part])),
    ...parts.map((part) => last(predicted, predicted[part]))];
}

function options(data, limit, floor) {
  const common = axisStyle();
  const hidden = { stroke: "transparent", points: { show: false } };
  const values = (_, marks) => marks.map((m) => number(m, decimalsFor(marks)));
  const all = [...data.slice(1).flat(), limit].filter((v) => v !== null);
  const [low, high] = [floor ?? Math.min(...all, 0), Math.max(...all, 0)];
  const room = 0.06 * (high - low || 1);
  return {
    padding: [8, 18, 0, 0],
    scales: { x: { time: false }, y: { range: () => [floor ?? low - room, high + room] } },
    axes: [
      { ...common, size: 26, space: 56, grid: { show: false }, values },
      { ...common, size: 48, space: 26, grid: { stroke: colour("line"), width: 1 }, values },
    ],
    series: [{},
      { stroke: colour("accent"), width: 1.5, points: { show: true, size: 8, fill: colour("accent") } },
      hidden, hidden,
      { stroke: colour("trace-y"), width: 2.25, dash: [7, 5], pxAlign: 0, points: { show: false } },
      hidden, hidden],
    bands: [{ series: [6, 5], fill: colour("band") }],
    hooks: { draw: [(chart) => drawIntervals(chart), (chart) => drawLevel(chart, limit)] },
  };
}

/** The interval of each measured value. */
function drawIntervals(chart) {
  const [hours, , low, high] = chart.data;
  const { ctx } = chart;
  ctx.save();
  ctx.strokeStyle = colour("accent");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.beginPath();
  hours.forEach((hour, i) => {
    if (low[i] === null) return;
    const x = chart.valToPos(hour, "x", true);
    ctx.moveTo(x, chart.valToPos(low[i], "y", true));
    ctx.lineTo(x, chart.valToPos(high[i], "y", true));
  });
  ctx.stroke();
  ctx.restore();
}
