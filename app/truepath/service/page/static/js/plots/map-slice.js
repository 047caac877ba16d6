/* The volumetric error in one plane of the volume, as SVG: needs nothing of the browser. */
import { s } from "../dom.js";
import { number } from "../texts.js";
import { decimalsOf, shown, unitOf } from "../units.js";

const MARGIN = { left: 62, right: 26, top: 20, bottom: 50 };
const [BARB, BARB_WIDTH] = [0.3, 0.13]; // of an arrow's length

/** Axes of a plane: those it lies along, and the one across it. */
export const PLANES = { XY: [0, 1, 2], XZ: [0, 2, 1], YZ: [1, 2, 0] };

/** Draw a slice in `element`; answers {update, close}.
 *
 * update({map, scale, factor, plane, level}): level counts the planes of the grid; scattered places are all seen
 */
export function drawSlice(element, first) {
  let shownSlice = first;
  const watcher = new ResizeObserver(() => draw(element, shownSlice));
  watcher.observe(element);
  return {
    update(next) {
      shownSlice = next;
      draw(element, next);
    },
    close: () => watcher.disconnect(),
  };
}

function draw(element, { map, scale, factor, plane, level }) {
  const [width, height] = [element.clientWidth, element.clientHeight];
  if (!width || !height) return;
  const [a, b, across] = PLANES[plane];
  const frame = fit(map.travel[a], map.travel[b], width, height);
  const points = map.isScattered ? map.points : map.points.filter(({ index }) => index[across] === level);
  element.replaceChildren(s("svg", { class: "slice", width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" },
    hatch(), outside(map, a, b, frame), border(frame),
    points.map((point) => mark(point, a, b, frame, scale, factor, map.hasDirection)), ticks(map, a, b, frame)));
}

/** Where mm lie: one scale for both directions, in the middle of the room. */
function fit([lowA, highA], [lowB, highB], width, height) {
  const room = [width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom];
  const perMm = Math.min(room[0] / (highA - lowA), room[1] / (highB - lowB));
  const left = MARGIN.left + 0.5 * (room[0] - perMm * (highA - lowA));
  const bottom = height - MARGIN.bottom - 0.5 * (room[1] - perMm * (highB - lowB));
  const x = (mm) => left + perMm * (mm - lowA);
  const y = (mm) => bottom - perMm * (mm - lowB);
  return { x, y, perMm, left: x(lowA), right: x(highA), top: y(highB), bottom: y(lowB) };
}

const hatch = () => s("defs", {}, s("pattern", { id: "unmeasured", width: 8, height: 8, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
  s("line", { class: "hatch", x1: 0, y1: 0, x2: 0, y2: 8 })));

/** What no line or point of the measurement has reached. */
function outside({ travel, measured }, a, b, { x, y, left, right, top, bottom }) {
  const bands = [];
  const band = (x0, y0, x1, y1) => x1 - x0 > 0.5 && y1 - y0 > 0.5
    && bands.push(s("rect", { class: "outside", x: x0, y: y0, width: x1 - x0, height: y1 - y0 }));
  const [ma, mb] = [measured[a] ?? travel[a], measured[b] ?? travel[b]];
  band(left, top, x(ma[0]), bottom);
  band(x(ma[1]), top, right, bottom);
  band(x(ma[0]), top, x(ma[1]), y(mb[1]));
  band(x(ma[0]), y(mb[0]), x(ma[1]), bottom);
  return bands;
}

const border = ({ left, right, top, bottom }) =>
  s("rect", { class: "frame", x: left, y: top, width: right - left, height: bottom - top });

function ticks({ travel }, a, b, { x, y, left, bottom, right, top }) {
  const at = ([low, high]) => [low, 0.5 * (low + high), high];
  const text = (mm) => number(shown(mm, "travel"), decimalsOf("travel"));
  const name = (i) => `${"XYZ"[i]} (${unitOf("travel")})`;
  return [
    ...at(travel[a]).map((mm) => s("text", { x: x(mm), y: bottom + 20, "text-anchor": "middle" }, text(mm))),
    ...at(travel[b]).map((mm) => s("text", { x: left - 9, y: y(mm) + 4, "text-anchor": "end" }, text(mm))),
    s("text", { class: "axis", x: 0.5 * (left + right), y: bottom + 42, "text-anchor": "middle" }, name(a)),
    s("text", { class: "axis", x: left - 44, y: 0.5 * (top + bottom), "text-anchor": "middle",
      transform: `rotate(-90 ${left - 44} ${0.5 * (top + bottom)})` }, name(b)),
  ];
}

/** An arrow of the part in the plane; its colour is of the whole length. */
function mark({ at_mm, error_um, length_um, isMeasured }, a, b, { x, y, perMm }, scale, factor, hasDirection) {
  const [px, py] = [x(at_mm[a]), y(at_mm[b])];
  const tone = scale.of(length_um);
  const filled = isMeasured ? { fill: tone } : { fill: "none", "stroke-width": 1.5 };
  const dot = s("circle", { cx: px, cy: py, r: hasDirection ? 2.5 : 6, stroke: tone, ...filled });
  const [dx, dy] = [a, b].map((i) => (error_um[i] * factor * perMm) / 1000);
  if (Math.hypot(dx, dy) < 1) return dot;
  const [tx, ty] = [px + dx, py - dy];
  const barb = (sign) => `${tx - BARB * dx + sign * BARB_WIDTH * dy} ${ty + BARB * dy + sign * BARB_WIDTH * dx}`;
  return [dot, s("path", { class: "arrow", stroke: tone, d: `M${px} ${py}L${tx} ${ty}M${barb(1)}L${tx} ${ty}L${barb(-1)}` })];
}
