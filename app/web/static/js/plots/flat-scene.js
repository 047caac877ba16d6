/* A scene of lines and dots in parallel projection, as SVG: drawn at once without WebGL, turned by dragging. */
import { mark, s } from "../dom.js";
import { number } from "../texts.js";
import { decimalsOf, unitOf } from "../units.js";
import { mix } from "./length-scale.js";

const MARGIN = { side: 62, top: 52, bottom: 40 };
const AWAY_PX = 13; // texts from their edge
const SHORTEST_PX = 30; // an edge that has room for texts
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
    const at = projection(own, room, width, height);
    svg.replaceChildren(...own.traces.map((trace, i) => s("g", { "data-trace": i, opacity: trace.opacity }, figure(trace, at))),
      ...axes(travelOf(own.traces[0]), at));
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

/** Places in pixels: the room fills the frame from wherever it is looked at. */
function projection({ around, above }, room, width, height) {
  const [c, d] = [Math.cos(around), Math.sin(around)];
  const [e, f] = [Math.cos(above), Math.sin(above)];
  const flat = ([x, y, z]) => [c * y - d * x, e * z - f * (c * x + d * y)];
  const corners = CORNERS.map((bits) => flat(corner(room, bits)));
  const [[left, right], [low, high]] = [0, 1].map((i) => corners.map((p) => p[i])).map((all) => [Math.min(...all), Math.max(...all)]);
  const scale = Math.min((width - 2 * MARGIN.side) / (right - left), (height - MARGIN.top - MARGIN.bottom) / (high - low));
  const [x0, y0] = [0.5 * width, 0.5 * (height + MARGIN.top - MARGIN.bottom)];
  return (place) => {
    const [u, v] = flat(place);
    return [x0 + scale * (u - 0.5 * (left + right)), y0 - scale * (v - 0.5 * (low + high))];
  };
}

const corner = (room, bits) => [0, 1, 2].map((i) => room[i][(bits >> i) & 1]);

const travelOf = ({ x, y, z }) => [x, y, z].map((all) => all.filter((v) => v !== null)).map((all) => [Math.min(...all), Math.max(...all)]);

function figure({ mode, x, y, z, line, marker, hovertext }, at) {
  const places = x.map((value, i) => (value === null ? null : at([value, y[i], z[i]]).map((v) => Math.round(10 * v) / 10)));
  return [mode.includes("lines") && strokes(line, places), mode.includes("markers") && dots(marker, places, hovertext)];
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
    const rim = symbol === "circle-open" ? { fill: "none", stroke: tone(i), "stroke-width": 1.5 } : { fill: tone(i), stroke: color, "stroke-width": width };
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
      return { low, high, middle: low.map((v, k) => 0.5 * (v + high[k])) };
    });
    const score = (edge) => (i === 2 ? -edge.middle[0] : edge.middle[1] - 0.01 * edge.middle[0]);
    const { low, high, middle: half } = edges.reduce((best, edge) => (score(edge) > score(best) + 1e-6 ? edge : best));
    if (Math.hypot(high[0] - low[0], high[1] - low[1]) < SHORTEST_PX) return [];
    const way = away(low, high, half, middle);
    const text = (value) => number(value, decimalsOf("travel"));
    return [label(half, way, `${"XYZ"[i]} (${unitOf("travel")})`, "axis"), label(low, way, text(ends[0])), label(high, way, text(ends[1]))];
  });
}

/** Direction across an edge that leads out of the picture. */
function away(low, high, half, middle) {
  const along = [high[0] - low[0], high[1] - low[1]];
  const length = Math.hypot(...along);
  const across = [-along[1] / length, along[0] / length];
  const outward = across[0] * (half[0] - middle[0]) + across[1] * (half[1] - middle[1]);
  return outward < 0 ? across.map((v) => -v) : across;
}

function label([x, y], [dx, dy], text, name) {
  const anchor = Math.abs(dx) < 0.35 ? "middle" : dx < 0 ? "end" : "start";
  return s("text", { class: name, x: x + AWAY_PX * dx, y: y + AWAY_PX * dy + 5 + 4 * dy, "text-anchor": anchor }, text);
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
