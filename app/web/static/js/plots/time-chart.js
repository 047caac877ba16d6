/* A quantity over hours: what was measured with its interval, what is predicted as a band, a limit. */
import { number } from "../texts.js";
import { colour, font } from "./colours.js";
import { drawLevel } from "./level.js";

/** Draw a chart; answers {close}.
 *
 * measured, predicted: {hours, value, low, high}, in shown units; limit: of the quantity, or null
 * floor: lowest value drawn, or null for where the values end
 */
export function drawOverTime(element, { measured, predicted, limit = null, floor = null }) {
  const data = rows(measured, predicted);
  const chart = new uPlot(options(element, data, limit, floor), data, element);
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

/** One column of hours; values where there are some, else null. */
function rows(measured, predicted) {
  const hours = [...measured.hours, ...predicted.hours];
  const first = ({ hours: own }, values) => [...values, ...Array(hours.length - own.length).fill(null)];
  const last = ({ hours: own }, values) => [...Array(hours.length - own.length).fill(null), ...values];
  const parts = ["value", "low", "high"];
  return [hours, ...parts.map((part) => first(measured, measured[part])),
    ...parts.map((part) => last(predicted, predicted[part]))];
}

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element, data, limit, floor) {
  const common = { stroke: colour("quiet"), font: font(12), ticks: { show: false } };
  const hidden = { stroke: "transparent", points: { show: false } };
  const values = (_, marks) => marks.map((m) => number(m, decimalsFor(marks)));
  const all = [...data.slice(1).flat(), limit].filter((v) => v !== null);
  const [low, high] = [floor ?? Math.min(...all, 0), Math.max(...all, 0)];
  const room = 0.06 * (high - low || 1);
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [8, 18, 0, 0],
    cursor: { show: false },
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

function decimalsFor(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  return step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
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
