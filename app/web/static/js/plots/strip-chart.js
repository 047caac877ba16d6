/* The last half minute of the tracker's signal. */
import { number } from "../texts.js";
import { shown } from "../units.js";
import { colour, font } from "./colours.js";

const WINDOW_S = 30;
const REDRAW_MS = 200;
const LIMIT = 2000;

/** Draw a strip chart; answers {add(time_s, [x, y, z] in mm), close}. */
export function drawStrip(element) {
  const data = [[], [], [], []];
  let origin = null;
  let fresh = false;
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

  return {
    add(time_s, position_mm) {
      if (data[0].length && time_s <= data[0][data[0].length - 1]) return;
      origin ??= position_mm;
      data[0].push(time_s);
      position_mm.forEach((v, i) => data[i + 1].push(shown(v - origin[i], "length")));
      trim(time_s);
      fresh = true;
    },
    close() {
      clearInterval(timer);
      watcher.disconnect();
      chart.destroy();
    },
  };
}

const sizeOf = (element) => ({ width: element.clientWidth, height: element.clientHeight });

function options(element) {
  const line = (name) => ({ stroke: colour(name), width: 2, points: { show: false }, pxAlign: 0 });
  const common = { stroke: colour("quiet"), font: font(12), ticks: { show: false } };
  return {
    ...sizeOf(element),
    legend: { show: false },
    padding: [6, 6, 0, 0],
    cursor: { show: false },
    scales: { x: { time: false, range: (_, low, high) => [Math.min(low, high - WINDOW_S), high] } },
    axes: [
      { ...common, show: false },
      { ...common, size: 48, space: 36, grid: { stroke: colour("line"), width: 1 },
        values: (_, marks) => marks.map((m) => number(m, Math.abs(m) < 1 && m ? 2 : 0)) },
    ],
    series: [{}, line("trace-x"), line("trace-y"), line("trace-z")],
  };
}
