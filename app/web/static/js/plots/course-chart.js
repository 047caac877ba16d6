/* How the expanded uncertainty came down while the machine moved, and where it is to get to. */
import { duration, number } from "../texts.js";
import { shown } from "../units.js";
import { colour, font } from "./colours.js";
import { COVERAGE } from "./error-chart.js";
import { drawLevel } from "./level.js";

const SHORTEST_S = 30;

/** Draw the course on a logarithmic scale; answers {update(course, target_um), close}.
 *
 * course: columns elapsed_s and volumetric_uncertainty_um (k = 1); target_um: k = 1, or null
 */
export function drawCourse(element) {
  const drawn = { target: null };
  const chart = new uPlot(options(element, drawn), [[], []], element);
  const watcher = new ResizeObserver(() => {
    if (element.clientWidth) chart.setSize(sizeOf(element));
  });
  watcher.observe(element);
  return {
    update({ elapsed_s, volumetric_uncertainty_um }, target_um) {
      drawn.target = target_um === null ? null : expanded(target_um);
      chart.setData([elapsed_s, volumetric_uncertainty_um.map(expanded)]);
    },
    close() {
      watcher.disconnect();
      chart.destroy();
    },
  };
}

const expanded = (um) => COVERAGE * shown(um, "error");

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element, drawn) {
  const common = { stroke: colour("quiet"), font: font(12), ticks: { show: false } };
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [8, 14, 0, 0],
    cursor: { show: false },
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
