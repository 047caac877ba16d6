/* The last half minute: how far the target was beside its line. */
import { number } from "../texts.js";
import { shown } from "../units.js";
import { colour, font } from "./colours.js";
import { createLineScope } from "./line-scope.js";

const WINDOW_S = 30;
const REDRAW_MS = 200;
const LIMIT = 2000;
const LEAST_RANGE_UM = 10;

/** Draw a strip chart; answers {add(time_s, [x, y, z] in mm, way as of the scope), newest(), isCommanded(), close}. */
export function drawStrip(element) {
  const data = [[], []];
  const scope = createLineScope();
  let fresh = false;
  let isCommanded = false;
  const chart = new uPlot(options(element), data, element);
  const watcher = new ResizeObserver(() => {
    if (element.clientWidth) chart.setSize(sizeOf(element));
  });
  watcher.observe(element);
  const timer = setInterval(redraw, REDRAW_MS);

  function redraw() {
    if (!fresh || document.hidden) return;
    fresh = false;
    chart.setData(data);
  }

  function trim(time_s) {
    let old = 0;
    while (data[0].length - old > LIMIT || data[0][old] < time_s - WINDOW_S) old += 1;
    if (old) for (const column of data) column.splice(0, old);
  }

  /** The line is fitted anew with each point: all that is shown of it holds against the same fit. */
  function show(line_um) {
    const first = data[1].length - line_um.length;
    line_um.forEach((um, i) => {
      if (first + i >= 0) data[1][first + i] = shown(um, "error");
    });
  }

  return {
    add(time_s, position_mm, way) {
      if (data[0].length && time_s <= data[0].at(-1)) return;
      const found = scope.add(time_s, position_mm, way);
      isCommanded = found.isCommanded;
      data[0].push(time_s);
      data[1].push(null);
      show(found.line_um);
      trim(time_s);
      fresh = true;
    },
    /** As shown now, in the unit of the panel; null where there is none. */
    newest: () => data[1].at(-1) ?? null,
    /** Whether the newest point was held against the line that was commanded. */
    isCommanded: () => isCommanded,
    close() {
      clearInterval(timer);
      watcher.disconnect();
      chart.destroy();
    },
  };
}

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element) {
  const common = { stroke: colour("quiet"), font: font(12), ticks: { show: false } };
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [8, 6, 8, 0],
    cursor: { show: false },
    scales: {
      x: { time: false, range: (_, low, high) => [Math.min(low, high - WINDOW_S), high] },
      y: { range: (_, low, high) => [0, Math.max(1.1 * (high ?? 0), shown(LEAST_RANGE_UM, "error"))] },
    },
    axes: [
      { ...common, show: false },
      { ...common, size: 48, space: 30, grid: { stroke: colour("line"), width: 1 },
        values: (_, marks) => marks.map((m) => number(m, Math.abs(m) < 1 && m ? 1 : 0)) },
    ],
    series: [{}, { stroke: colour("accent"), width: 2, points: { show: false }, pxAlign: 0, spanGaps: false }],
  };
}
