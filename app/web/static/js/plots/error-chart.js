/* One error motion over its axis, with the band of its expanded uncertainty (k = 2). */
import { number } from "../texts.js";
import { decimalsOf, shown, unitOf } from "../units.js";
import { colour, font } from "./colours.js";

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

/** Draw a table; `reach` fixes the scale to ± reach, `read(text)` follows the cursor.
 *
 * sparse: marks at 0 and ± reach alone, for charts too low for more
 * Answers {update(table, reach), close}.
 */
export function drawErrors(element, table, { reach = null, read = () => {}, sparse = false } = {}) {
  const drawn = { table, reach, sparse, data: columns(table) };
  const chart = new uPlot(options(element, drawn, read), rows(drawn.data), element);
  const watcher = new ResizeObserver(() => {
    if (element.clientWidth) chart.setSize(sizeOf(element));
  });
  watcher.observe(element);
  return {
    update(next, nextReach) {
      Object.assign(drawn, { table: next, reach: nextReach, data: columns(next) });
      chart.setData(rows(drawn.data));
    },
    close() {
      watcher.disconnect();
      chart.destroy();
    },
  };
}

const rows = ({ x, value, low, high, up, down }) =>
  [x, value, low, high, ...(up ? [up, down] : [])];

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element, drawn, read) {
  const accent = colour("accent");
  const range = () => scale(drawn.reach ?? reachOf(drawn.table));
  // Not aligned to whole pixels: a smooth error must not look like a staircase.
  const line = (stroke, width, dash) => ({ stroke, width, dash, points: { show: false }, pxAlign: 0 });
  const edge = line("transparent");
  const ways = drawn.data.up ? [line(colour("trace-y"), 1.75), line(colour("trace-z"), 1.75, [5, 4])] : [];
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [6, 18, 0, 0],
    cursor: { drag: { x: false, y: false }, y: false, points: { size: 8 } },
    scales: { x: { time: false }, y: { range } },
    axes: axes(drawn),
    series: [{}, line(accent, 2.25), edge, edge, ...ways],
    bands: [{ series: [3, 2], fill: colour("band") }],
    hooks: {
      setCursor: [(chart) => read(reading(chart.cursor.idx, drawn))],
      drawAxes: [drawZero],
    },
  };
}

function axes(drawn) {
  const common = {
    stroke: colour("quiet"), font: font(12), ticks: { show: false },
    grid: { stroke: colour("line"), width: 1 },
  };
  const x = { ...common, size: 26, space: 56, grid: { show: false },
    values: (_, marks) => marks.map((m) => number(m, decimalsFor(marks))) };
  const y = { ...common, size: 44, space: 26,
    ...(drawn.sparse ? { splits: () => [-drawn.reach, 0, drawn.reach] } : {}),
    values: (_, marks) => marks.map((m) => number(m, decimalsFor(marks))) };
  return [x, y];
}

function decimalsFor(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  const isWhole = (value) => Math.abs(value - Math.round(value)) < 1e-6 * value;
  return [0, 1, 2].find((digits) => isWhole(step * 10 ** digits)) ?? 3;
}

const scale = (reach) => [-1.08 * (reach || 1), 1.08 * (reach || 1)];

function drawZero(chart) {
  const y = Math.round(chart.valToPos(0, "y", true)) + 0.5;
  const { left, width } = chart.bbox;
  chart.ctx.save();
  chart.ctx.strokeStyle = colour("line-strong");
  chart.ctx.lineWidth = 1;
  chart.ctx.beginPath();
  chart.ctx.moveTo(left, y);
  chart.ctx.lineTo(left + width, y);
  chart.ctx.stroke();
  chart.ctx.restore();
}

function reading(index, { table, data }) {
  if (index === null || index === undefined) return "";
  const digits = decimalsOf(table.kind);
  const position = `${table.axis} ${number(data.x[index], decimalsOf(table.positionKind))} `
    + unitOf(table.positionKind);
  return `${position}: ${number(data.value[index], digits)} ± `
    + `${number(data.expanded[index], digits)} ${unitOf(table.kind)}`;
}
