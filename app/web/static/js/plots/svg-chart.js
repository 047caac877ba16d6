/* A small chart in SVG: a frame with named axes, redrawn as its element changes size. */
import { mark, s } from "../dom.js";
import { number } from "../texts.js";

const MARGIN = { left: 64, right: 20, top: 14, bottom: 52 };

/** Draw in an element; answers {update, close}.
 *
 * scene: {x: [low, high], y: [low, high], names: [x, y], marks(frame): elements, xTicks: places or null}
 */
export function drawChart(element, first) {
  let scene = first;
  const svg = s("svg", { class: "svg-chart", "aria-hidden": "true" });
  element.replaceChildren(svg);

  function draw() {
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width || !height) return;
    for (const [name, value] of [["width", width], ["height", height], ["viewBox", `0 0 ${width} ${height}`]]) mark(svg, name, value);
    const frame = frameOf(scene, width, height);
    svg.replaceChildren(...grid(scene, frame), ...[scene.marks(frame)].flat(Infinity).filter(Boolean), ...names(scene, frame));
  }

  const watcher = new ResizeObserver(draw);
  watcher.observe(element);
  return {
    update(next) {
      scene = next;
      draw();
    },
    close: () => watcher.disconnect(),
  };
}

function frameOf({ x: [x0, x1], y: [y0, y1] }, width, height) {
  const [left, right, top, bottom] = [MARGIN.left, width - MARGIN.right, MARGIN.top, height - MARGIN.bottom];
  return { left, right, top, bottom, x: (v) => left + ((right - left) * (v - x0)) / (x1 - x0 || 1),
    y: (v) => bottom - ((bottom - top) * (v - y0)) / (y1 - y0 || 1) };
}

function grid({ x, y, xTicks = null }, frame) {
  const columns = xTicks ?? ticksOf(x, 7);
  const rows = ticksOf(y, 5);
  const text = (marks) => (v) => number(v, digitsOf(marks));
  return [
    ...rows.map((v) => s("line", { class: "grid", x1: frame.left, x2: frame.right, y1: frame.y(v), y2: frame.y(v) })),
    s("line", { class: "base", x1: frame.left, x2: frame.right, y1: frame.bottom, y2: frame.bottom }),
    ...rows.map((v) => s("text", { x: frame.left - 8, y: frame.y(v) + 4, "text-anchor": "end" }, text(rows)(v))),
    ...columns.map((v) => s("text", { x: frame.x(v), y: frame.bottom + 20, "text-anchor": "middle" }, text(columns)(v))),
  ];
}

function names({ names: [across, up] }, { left, right, top, bottom }) {
  const [x, y] = [0.5 * (left + right), 0.5 * (top + bottom)];
  return [s("text", { class: "axis", x, y: bottom + 43, "text-anchor": "middle" }, across),
    s("text", { class: "axis", x: 15, y, "text-anchor": "middle", transform: `rotate(-90 15 ${y})` }, up)];
}

/** Round places in a range, about so many. */
function ticksOf([low, high], count) {
  const rough = (high - low || 1) / count;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = decade * [1, 2, 5, 10].find((one) => one * decade >= rough);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}

function digitsOf(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  return step >= 1 ? 0 : Math.ceil(-Math.log10(step) - 1e-9);
}
