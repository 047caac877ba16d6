/* A scene of lines and dots in parallel projection, as SVG: drawn at once without WebGL, turned by dragging. */
import { mark, s } from "../dom.js";
import { number } from "../texts.js";
import { decimalsOf, unitOf } from "../units.js";
import { mix } from "./length-scale.js";

const ROOM_MARGIN = { side: 10, top: 56, bottom: 10 }; // below the buttons of the views
const TEXT_MARGIN = { side: 62, top: 56, bottom: 40 };
const AWAY_PX = 13; // texts from their edge
const SHORTEST_PX = 30; // an edge that has room for its name
const ENDS_PX = { across: 120, down: 36 }; // for its ends as well
const TURN_PER_PX = 0.008;
const STEEPEST = Math.PI / 2;
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7];

/** Draw traces, as plotly.js takes them, in an element; answers {restyle, replace, look, close}.
 *
 * traces: the first one has the edges of the travel, along which the axes are named
 * room: of X, Y and Z in shown units, which fills the frame; look(eye): from where, {x, y, z}
 */
export function drawFlat(element, traces, room, eye) {
  const svg = s("svg", { class: "flat-scene", "aria-hidden": "true" });
  const own = { traces: [...traces], ...angles(eye) };
  let due = null;
  element.replaceChildren(svg);
  const watcher = new ResizeObserver(draw);
  watcher.observe(element);
  turnByDragging(svg, (across_px, down_px) => {
    own.around -= TURN_PER_PX * across_px;
    own.above = Math.max(-STEEPEST, Math.min(STEEPEST, own.above + TURN_PER_PX * down_px));
    due ??= requestAnimationFrame(draw);
  });

  function draw() {
    due = null;
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width || !height) return;
    for (const [name, value] of [["width", width], ["height", height], ["viewBox", `0 0 ${width} ${height}`]]) mark(svg, name, value);
    const travel = travelOf(own.traces[0]);
    const at = projection(own, room, travel, width, height);
    svg.replaceChildren(...own.traces.map((trace, i) => s("g", { "data-trace": i, opacity: trace.opacity }, figure(trace, at))),
      ...axes(travel, at));
  }

  return {
    restyle(change, which) {
      which.forEach((index, k) => {
        const changed = Object.entries(change).map(([name, values]) => [name, values[k]]);
        own.traces[index] = { ...own.traces[index], ...Object.fromEntries(changed) };
      });
      draw();
    },
    replace(next) {
      own.traces = [...next];
      draw();
    },
    look(from) {
      Object.assign(own, angles(from));
      draw();
    },
    close: () => watcher.disconnect(),
  };
}

/** From where an eye looks: around Z from X on, and above the plane of X and Y, in rad. */
function angles({ x, y, z }) {
  const flat = Math.hypot(x, y);
  return { around: flat > 0 ? Math.atan2(y, x) : -Math.PI / 2, above: Math.atan2(z, flat) };
}

/** Places in pixels: room and travel, with the texts at its edges, fill the frame from wherever they are looked at. */
function projection({ around, above }, room, travel, width, height) {
  const [c, d] = [Math.cos(around), Math.sin(around)];
  const [e, f] = [Math.cos(above), Math.sin(above)];
  const flat = ([x, y, z]) => [c * y - d * x, f * (c * x + d * y) - e * z];
  const boxes = [[room, ROOM_MARGIN], [travel, TEXT_MARGIN]].map(([box, { side, top, bottom }]) => {
    const corners = CORNERS.map((bits) => flat(corner(box, bits)));
    const extent = (i, before, after) => ({ low: Math.min(...corners.map((p) => p[i])), high: Math.max(...corners.map((p) => p[i])), before, after });
    return [extent(0, side, side), extent(1, top, bottom)];
  });
  const [across, down] = [0, 1].map((i) => boxes.map((box) => box[i]));
  const scale = Math.min(largestScale(across, width), largestScale(down, height));
  const [x0, y0] = [start(across, scale, width), start(down, scale, height)];
  return (place) => {
    const [u, v] = flat(place);
    return [x0 + scale * u, y0 + scale * v];
  };
}

/** Pixels a unit at which extents, each with its margins in pixels, lie within a size. */
const largestScale = (extents, size) =>
  Math.min(...extents.flatMap((a) => extents.map((b) => (size - a.before - b.after) / (b.high - a.low))));

/** Where the origin lies if extents with their margins are in the middle of a size. */
function start(extents, scale, size) {
  const first = Math.min(...extents.map(({ low, before }) => scale * low - before));
  const last = Math.max(...extents.map(({ high, after }) => scale * high + after));
  return 0.5 * (size - first - last);
}

const corner = (room, bits) => [0, 1, 2].map((i) => room[i][(bits >> i) & 1]);

const travelOf = ({ x, y, z }) => [x, y, z].map((all) => all.filter((v) => v !== null)).map((all) => [Math.min(...all), Math.max(...all)]);

function figure({ mode, x, y, z, line, marker, hovertext, text, textfont }, at) {
  const places = x.map((value, i) => (value === null ? null : at([value, y[i], z[i]]).map((v) => Math.round(10 * v) / 10)));
  return [mode.includes("lines") && strokes(line, places), mode.includes("markers") && dots(marker, places, hovertext),
    mode.includes("text") && text.map((words, i) => words && label(places[i], [0, 1], words, "middle", null, textfont.color))];
}

/** One path a colour; null breaks a line. */
function strokes(line, places) {
  const tone = toneOf(line);
  const paths = new Map();
  places.forEach((place, i) => {
    if (place) paths.set(tone(i), `${paths.get(tone(i)) ?? ""}${places[i - 1] ? "L" : "M"}${place.join(" ")}`);
  });
  return [...paths].map(([stroke, d]) => s("path", { d, stroke, "stroke-width": line.width }));
}

function dots(marker, places, texts) {
  const tone = toneOf(marker);
  const of = (value, i) => (Array.isArray(value) ? value[i] : value);
  const { color, width } = marker.line ?? {};
  return places.map((place, i) => {
    if (!place) return null;
    const [symbol, radius] = [of(marker.symbol, i), 0.5 * of(marker.size, i) + 0.5 * (width ?? 0)];
    const rim = symbol === "circle-open" ? { fill: "none", stroke: tone(i), "stroke-width": 1.5 } : { fill: tone(i), stroke: color ?? "none", "stroke-width": width };
    return dot(symbol, place, radius, rim, texts && s("title", {}, texts[i].replaceAll("<br>", "\n")));
  });
}

function dot(symbol, [x, y], radius, rim, title) {
  if (symbol !== "diamond") return s("circle", { cx: x, cy: y, r: radius, ...rim }, title);
  const corners = [[0, -radius], [radius, 0], [0, radius], [-radius, 0]];
  return s("polygon", { points: corners.map(([right, down]) => `${x + right},${y + down}`).join(" "), ...rim }, title);
}

/** Colour of the i-th place: one for all, or by a value on a scale from 0. */
function toneOf({ color, colorscale, cmax }) {
  if (!Array.isArray(color)) return () => color;
  const stops = colorscale.map(([, stop]) => stop);
  return (i) => mix(stops, Math.min(1, color[i] / cmax));
}

/** Name and ends of each axis, along the edge that is lowest in the picture, for Z leftmost. */
function axes(travel, at) {
  const middle = at(travel.map(([low, high]) => 0.5 * (low + high)));
  return travel.flatMap((ends, i) => {
    const edges = CORNERS.filter((bits) => !((bits >> i) & 1)).map((bits) => {
      const [low, high] = [bits, bits | (1 << i)].map((b) => at(corner(travel, b)));
      return { low, high, half: low.map((v, k) => 0.5 * (v + high[k])) };
    });
    const score = ({ half }) => (i === 2 ? -half[0] : half[1] - 0.01 * half[0]);
    const edge = edges.reduce((best, other) => (score(other) > score(best) + 1e-6 ? other : best));
    return textsAt(edge, middle, `${"XYZ"[i]} (${unitOf("travel")})`, ends.map((value) => number(value, decimalsOf("travel"))));
  });
}

/** The texts of an edge that has room for them: its name, and its ends, which stay within it beside those of another edge. */
function textsAt({ low, high, half }, middle, name, ends) {
  const along = [0, 1].map((k) => high[k] - low[k]);
  const length = Math.hypot(...along);
  if (length < SHORTEST_PX) return [];
  const way = away(along.map((v) => v / length), half, middle);
  const texts = [label(half, way, name, anchorOf(way[0]), "axis")];
  if (Math.abs(along[0]) < ENDS_PX.across && Math.abs(along[1]) < ENDS_PX.down) return texts;
  const inward = Math.abs(along[0]) > 0.5 * length ? along[0] : null;
  return [...texts, label(low, way, ends[0], anchorOf(inward ?? way[0])), label(high, way, ends[1], anchorOf(inward === null ? way[0] : -inward))];
}

/** Direction across an edge that leads out of the picture. */
function away([right, down], half, middle) {
  const outward = -down * (half[0] - middle[0]) + right * (half[1] - middle[1]);
  return outward < 0 ? [down, -right] : [-down, right];
}

/** On which side of its place a text stands: right, left or, where that hardly matters, in the middle. */
const anchorOf = (right) => (Math.abs(right) < 0.35 ? "middle" : right < 0 ? "end" : "start");

function label([x, y], [dx, dy], text, anchor, name, tone = null) {
  return s("text", { class: name, style: tone && `fill: ${tone}`, x: x + AWAY_PX * dx, y: y + AWAY_PX * dy + 5 + 4 * dy, "text-anchor": anchor }, text);
}

function turnByDragging(svg, turn) {
  let from = null;
  svg.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (!from) return;
    turn(event.clientX - from[0], event.clientY - from[1]);
    from = [event.clientX, event.clientY];
  });
  for (const type of ["pointerup", "pointercancel"]) svg.addEventListener(type, () => (from = null));
}
