/* Where simulation and measurement disagree: strips of cells, darker where it is more. */
import { h } from "../dom.js";
import { card, tableFrame } from "../parts.js";
import { duration, known, number, t } from "../texts.js";
import { quantity } from "../units.js";

const MOST_CELLS = 60;
const BINS = 12;
const MOST_DECIMALS = 3;

/** Strips over lines, axes, time and temperatures, each before and after; null where the discovery tells none.
 *
 * lines: of all Runs, in the order of time: {run, segment, axis, direction, time_s, before_um, after_um, temperature_degC}
 */
export function stripsCard(lines) {
  if (!lines?.length) return null;
  const strips = stripsOf(lines);
  const highest = Math.max(...strips.flatMap(({ cells }) => cells.flatMap(({ before, after }) => [before, after])));
  const element = card(t("strips.title"), h("p", { class: "quiet" }, t("strips.text")), scale(highest),
    strips.map((strip) => drawStrip(strip, highest)),
    h("details", { class: "strips-table" }, h("summary", {}, t("strips.table")), strips.map(table)));
  element.dataset.strips = "";
  return element;
}

function stripsOf(lines) {
  const sensors = [...new Set(lines.flatMap(({ temperature_degC: known }) => Object.keys(known ?? {})))];
  const begins = beginsOf(lines);
  const strips = [
    { name: t("strips.lines"), cells: chunks(lines) },
    { name: t("strips.axes"), cells: byAxis(lines), isNamed: true },
    { name: t("strips.time"), cells: bins(lines, ({ run, time_s }) => time_s - begins.get(run), duration) },
    ...sensors.map((sensor) => ({ name: t("where.temperature", { of: known(`sensor.${sensor}`, sensor) }),
      cells: bins(lines, ({ temperature_degC: known }) => known?.[sensor], (celsius, width) => `${number(celsius, decimalsOf(width))} °C`) })),
  ];
  return strips.filter(({ cells }) => cells.length > 1);
}

/** When the first line of each Run was driven: trackers count from when they were switched on. */
function beginsOf(lines) {
  const begins = new Map();
  for (const { run, time_s } of lines) begins.set(run, Math.min(time_s, begins.get(run) ?? Infinity));
  return begins;
}

/** Cells of as many neighbouring lines each as fit; the row of the path names a line. */
function chunks(lines) {
  const size = Math.ceil(lines.length / MOST_CELLS);
  const parts = Array.from({ length: Math.ceil(lines.length / size) }, (_, i) => lines.slice(i * size, (i + 1) * size));
  const rows = ({ segment }) => number(segment);
  return parts.map((part) => cell(part.length > 1 ? `${rows(part[0])} … ${rows(part.at(-1))}` : rows(part[0]), part));
}

function byAxis(lines) {
  const names = [...new Set(lines.map(({ axis, direction }) => axis + direction).filter(Boolean))].sort();
  return names.map((name) => cell(name.replace("-", "−"), lines.filter(({ axis, direction }) => axis + direction === name)));
}

/** Cells of equal width over a number; those without lines are left out. */
function bins(lines, valueOf, word) {
  const known = lines.filter((line) => Number.isFinite(valueOf(line)));
  const values = known.map(valueOf);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  if (!(high > low)) return [];
  const place = (value) => Math.min(BINS - 1, Math.floor((BINS * (value - low)) / (high - low)));
  const at = (i) => low + ((high - low) * i) / BINS;
  return Array.from({ length: BINS }, (_, i) => [i, known.filter((line) => place(valueOf(line)) === i)])
    .filter(([, part]) => part.length)
    .map(([i, part]) => cell(`${word(at(i), at(1) - low)} … ${word(at(i + 1), at(1) - low)}`, part));
}

/** Decimals that tell the ends of a cell of this width apart; at least one. */
const decimalsOf = (width) => Math.min(MOST_DECIMALS, Math.max(1, Math.ceil(-Math.log10(width))));

const cell = (name, part) => ({ name, count: part.length,
  before: rms(part.map((line) => line.before_um)), after: rms(part.map((line) => line.after_um)) });

const rms = (values) => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / values.length);

function drawStrip({ name, cells, isNamed }, highest) {
  const row = (kind) => h("div", { class: "strip-row" }, h("span", { class: "strip-kind" }, t(`strips.${kind}`)),
    h("div", { class: "strip-cells" }, cells.map((one) => {
      const shown = h("i", { title: `${one.name}: ${quantity(one[kind], "gap")}` });
      shown.style.setProperty("--heat", `${Math.round((100 * one[kind]) / (highest || 1))}%`);
      return shown;
    })));
  const ends = isNamed ? cells.map((one) => one.name) : [cells[0].name.split(" … ")[0], cells.at(-1).name.split(" … ").at(-1)];
  return h("div", { class: "heat-strip", "aria-hidden": "true" }, h("b", {}, name), row("before"), row("after"),
    h("div", { class: `strip-ends${isNamed ? " is-named" : ""}` }, ends.map((end) => h("span", {}, end))));
}

const scale = (highest) => h("p", { class: "strip-scale", "aria-hidden": "true" },
  h("span", {}, quantity(0, "gap")), h("i"), h("span", {}, quantity(highest, "gap")));

function table({ name, cells }) {
  const right = (tag, text) => h(tag, { class: "right" }, text);
  return tableFrame(name, h("table", {},
    h("thead", {}, h("tr", {}, h("th", {}, name), right("th", t("strips.count")), right("th", t("strips.before")), right("th", t("strips.after")))),
    h("tbody", {}, cells.map((one) => h("tr", {}, h("td", {}, one.name), right("td", number(one.count)),
      right("td", quantity(one.before, "gap")), right("td", quantity(one.after, "gap")))))));
}
