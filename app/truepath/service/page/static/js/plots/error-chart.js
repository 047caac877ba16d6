/* One error motion over its axis, with the band of its expanded uncertainty (k = 2). */
import { number, t } from "../texts.js";
import { decimalsOf, shown, unitOf } from "../units.js";
import { colour, font } from "./css-colour.js";
import { axisStyle, drawFilling, drawLevel } from "./filling-chart.js";

export const COVERAGE = 2;

/** Values of a table in shown units: {x, value, low, high, expanded, up, down}.
 *
 * up, down: approaching with growing and with falling position, null where nothing tells them apart
 */
export function columns(table) {
  const positions = table.positions.map((v) => shown(v, table.positionKind));
  const value = table.values.map((v) => shown(v, table.kind));
  const expanded = table.uncertainties.map((u) => COVERAGE * shown(u, table.kind));
  const half = table.halves?.map((v) => shown(v, table.kind));
  return {
    x: positions, value, expanded,
    low: value.map((v, i) => v - expanded[i]),
    high: value.map((v, i) => v + expanded[i]),
    up: half ? value.map((v, i) => v + half[i]) : null,
    down: half ? value.map((v, i) => v - half[i]) : null,
  };
}

/** Least and largest that is drawn of a table with 0 among it, in shown units. */
export function extentOf(table) {
  const { low, high, up, down } = columns(table);
  const all = [low, high, up ?? [], down ?? [], 0].flat();
  return [Math.min(...all), Math.max(...all)];
}

/** Largest magnitude that is drawn of a table, in shown units. */
export function reachOf(table) {
  const { low, high, up, down } = columns(table);
  return Math.max(...[low, high, up ?? [], down ?? []].flat().map(Math.abs));
}

/** The next round number: a scale that goes down in steps while values settle. */
export function roundReach(reach) {
  const decade = 10 ** Math.floor(Math.log10(reach || 1));
  return decade * [1, 1.5, 2, 3, 4, 6, 8, 10].find((step) => step * decade >= reach - 1e-12);
}

/** Draw a table; `read(text)` follows the cursor.
 *
 * span: height of the scale in shown units, which then lies where the table is; null for the table's own
 * reach: fixes the scale to ± reach instead, with marks at 0 and ± reach alone, for charts too low for more
 * Answers {update(table, reach), close}.
 */
export function drawErrors(element, table, { reach = null, span = null, read = () => {} } = {}) {
  const drawn = { table, reach, span, data: columns(table) };
  const { chart, close } = drawFilling(element, rows(drawn.data), options(drawn, read));
  return {
    update(next, nextReach) {
      Object.assign(drawn, { table: next, reach: nextReach, data: columns(next) });
      chart.setData(rows(drawn.data));
    },
    close,
  };
}

const rows = ({ x, value, low, high, up, down }) =>
  [x, value, low, high, ...(up ? [up, down] : [])];

function options(drawn, read) {
  const accent = colour("accent");
  const range = () => (drawn.reach === null ? around(drawn) : symmetric(drawn.reach));
  // Not aligned to whole pixels: a smooth error must not look like a staircase.
  const line = (stroke, width, dash) => ({ stroke, width, dash, points: { show: false }, pxAlign: 0 });
  const edge = line("transparent");
  const ways = drawn.data.up ? [line(colour("trace-y"), 1.75), line(colour("trace-z"), 1.75, [5, 4])] : [];
  return {
    padding: [6, 18, 0, 0],
    cursor: { drag: { x: false, y: false }, y: false, points: { size: 8 } },
    scales: { x: { time: false }, y: { range } },
    axes: axes(drawn),
    series: [{}, line(accent, 2.25), edge, edge, ...ways],
    bands: [{ series: [3, 2], fill: colour("band") }],
    hooks: {
      setCursor: [(chart) => read(reading(chart.cursor.idx, drawn))],
      drawAxes: [(chart) => hatchUnmeasured(chart, drawn.table), drawZero],
    },
  };
}

function axes({ table, reach }) {
  const named = reach === null;
  const label = (text) => (named ? { label: text, labelSize: 18, labelGap: 2, labelFont: font(13) } : {});
  const common = {
    ...axisStyle(), grid: { stroke: colour("line"), width: 1 },
    values: (_, marks) => marks.map((m) => number(m, decimalsFor(marks))),
  };
  const x = { ...common, size: 24, space: 56, grid: { show: false }, ...label(`${table.axis} (${unitOf(table.positionKind)})`) };
  const y = { ...common, size: named ? 40 : 44, space: 26, ...label(`${table.symbol} (${unitOf(table.kind)})`),
    ...(named ? {} : { splits: () => [-reach, 0, reach] }) };
  return [x, y];
}

/** Decimals that tell marks of a scale apart. */
export function decimalsFor(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  const isWhole = (value) => Math.abs(value - Math.round(value)) < 1e-6 * value;
  return [0, 1, 2].find((digits) => isWhole(step * 10 ** digits)) ?? 3;
}

const symmetric = (reach) => [-1.08 * (reach || 1), 1.08 * (reach || 1)];

/** What is drawn in the middle of a scale of that height, or of its own. */
function around({ table, span }) {
  const [low, high] = extentOf(table);
  const half = 0.54 * (span ?? high - low) || 1;
  const middle = 0.5 * (low + high);
  return [middle - half, middle + half];
}

/** Hatch what lies beyond the measured range: there the table is continued, not measured. */
function hatchUnmeasured(chart, { measured, positionKind }) {
  if (!measured) return;
  const { ctx, bbox: { left, top, width, height } } = chart;
  const [from, to] = measured.map((v) => chart.valToPos(shown(v, positionKind), "x", true));
  ctx.save();
  ctx.strokeStyle = colour("line-strong");
  ctx.lineWidth = devicePixelRatio;
  for (const [begin, end] of [[left, from], [to, left + width]]) {
    if (end - begin < 1) continue;
    ctx.save();
    ctx.beginPath();
    ctx.rect(begin, top, end - begin, height);
    ctx.clip();
    ctx.beginPath();
    for (let x = begin - height; x < end; x += 7 * devicePixelRatio) {
      ctx.moveTo(x, top + height);
      ctx.lineTo(x + height, top);
    }
    ctx.stroke();
    ctx.restore();
  }
  ctx.restore();
}

const drawZero = (chart) => drawLevel(chart, 0, { tone: "line-strong", width: 1, dash: [] });

function reading(index, { table, data }) {
  if (index === null || index === undefined) return "";
  const digits = decimalsOf(table.kind);
  const position = `${table.axis} ${number(data.x[index], decimalsOf(table.positionKind))} `
    + unitOf(table.positionKind);
  return `${position}: ${number(data.value[index], digits)} ± `
    + `${number(data.expanded[index], digits)} ${unitOf(table.kind)}`
    + (table.extrapolated[index] ? ` ${t("result.not_measured")}` : "");
}
