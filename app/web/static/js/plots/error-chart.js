/* One error motion over its axis, with the band of its expanded uncertainty (k = 2). */
import { number } from "../texts.js";
import { decimalsOf, shown, unitOf } from "../units.js";
import { colour, font } from "./colours.js";

export const COVERAGE = 2;

/** Values of a table in shown units: {x, value, low, high, expanded}. */
export function columns(table) {
  const positions = table.positions.map((v) => shown(v, table.positionKind));
  const value = table.values.map((v) => shown(v, table.kind));
  const expanded = table.uncertainties.map((u) => COVERAGE * shown(u, table.kind));
  return {
    x: positions, value, expanded,
    low: value.map((v, i) => v - expanded[i]),
    high: value.map((v, i) => v + expanded[i]),
  };
}

/** Largest magnitude that a table's band reaches, in shown units. */
export function reachOf(table) {
  const { low, high } = columns(table);
  return Math.max(...low.map(Math.abs), ...high.map(Math.abs));
}

/** Draw a table; `reach` fixes the scale to ± reach, `read(text)` follows the cursor. */
export function drawErrors(element, table, { reach = null, read = () => {} } = {}) {
  const data = columns(table);
  const chart = new uPlot(options(element, table, data, reach, read),
    [data.x, data.value, data.low, data.high], element);
  const watcher = new ResizeObserver(() => {
    if (element.clientWidth) chart.setSize(sizeOf(element));
  });
  watcher.observe(element);
  return {
    close() {
      watcher.disconnect();
      chart.destroy();
    },
  };
}

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element, table, data, reach, read) {
  const accent = colour("accent");
  const range = () => scale(reach ?? reachOf(table));
  // Not aligned to whole pixels: a smooth error must not look like a staircase.
  const edge = { stroke: "transparent", points: { show: false }, pxAlign: 0 };
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [6, 18, 0, 0],
    cursor: { drag: { x: false, y: false }, y: false, points: { size: 8 } },
    scales: { x: { time: false }, y: { range } },
    axes: axes(table),
    series: [
      {},
      { stroke: accent, width: 2.25, points: { show: false }, pxAlign: 0 },
      edge,
      edge,
    ],
    bands: [{ series: [3, 2], fill: colour("band") }],
    hooks: {
      setCursor: [(chart) => read(reading(chart.cursor.idx, table, data))],
      drawAxes: [drawZero],
    },
  };
}

function axes(table) {
  const common = {
    stroke: colour("quiet"), font: font(12), ticks: { show: false },
    grid: { stroke: colour("line"), width: 1 },
  };
  const x = { ...common, size: 26, space: 56, grid: { show: false },
    values: (_, marks) => marks.map((m) => number(m, decimalsFor(marks))) };
  const y = { ...common, size: 44, space: 26,
    values: (_, marks) => marks.map((m) => number(m, decimalsFor(marks))) };
  return [x, y];
}

function decimalsFor(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  return step >= 1 ? 0 : Math.min(3, Math.ceil(-Math.log10(step) - 1e-9));
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

function reading(index, table, data) {
  if (index === null || index === undefined) return "";
  const digits = decimalsOf(table.kind);
  const position = `${table.axis} ${number(data.x[index], decimalsOf(table.positionKind))} `
    + unitOf(table.positionKind);
  return `${position}: ${number(data.value[index], digits)} ± `
    + `${number(data.expanded[index], digits)} ${unitOf(table.kind)}`;
}
