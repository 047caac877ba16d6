/* The volumetric error as arrows in space. */
import { quantity } from "../units.js";
import { colour } from "./css-colour.js";
import { coordinates, drawScene, edges } from "./scene.js";

const MOST = 5; // arrows an axis: more hide each other
const ROOM = 0.13; // of the travel's diagonal, for arrows that leave it: beyond they are cut
const [BARB, BARB_WIDTH] = [0.3, 0.13]; // of an arrow's length
const TRACE = { shafts: 1, dots: 2 };

/** Draw a map in `element`; answers {update, exaggerate, view, close}.
 *
 * map: as `readMap` gives it; scale: of `lengthScale`; factor: by which arrows are longer than the errors
 */
export async function drawVolume(element, map, scale, factor) {
  const drawn = { points: thinned(map), scale, factor };
  const scene = await drawScene(element, traces(map, drawn), widened(map.travel));
  return {
    update(next, nextScale) {
      Object.assign(drawn, { points: thinned(next), scale: nextScale });
      scene.replace(traces(next, drawn));
    },
    exaggerate(next) {
      drawn.factor = next;
      const { x, y, z } = shafts(drawn);
      scene.restyle({ x: [x], y: [y], z: [z] }, [TRACE.shafts]);
    },
    view: scene.view,
    close: scene.close,
  };
}

function widened(travel) {
  const room = ROOM * Math.hypot(...travel.map(([low, high]) => high - low));
  return travel.map(([low, high]) => [low - room, high + room]);
}

/** Points of every other plane, ends included, where there are too many. */
function thinned({ points, count, isScattered }) {
  if (isScattered) return points;
  const step = Math.max(1, Math.ceil((count - 1) / (MOST - 1)));
  return points.filter(({ index }) => index.every((i) => i % step === 0));
}

function traces(map, drawn) {
  const base = { type: "scatter3d", showlegend: false };
  const { points, scale } = drawn;
  const colours = { cmin: 0, cmax: scale.top_um, colorscale: scale.plotly };
  return [
    { ...base, mode: "lines", hoverinfo: "skip", line: { color: colour("line-strong"), width: 1.5 }, ...edges(map.travel) },
    { ...base, mode: "lines", hoverinfo: "skip", ...shafts(drawn),
      line: { width: 4, color: points.flatMap((p) => Array(7).fill(p.length_um)), ...colours } },
    { ...base, mode: "markers", ...coordinates(points.map((p) => p.at_mm)), hoverinfo: "text", hovertext: points.map(spoken),
      hoverlabel: { bgcolor: colour("raised"), bordercolor: colour("line-strong"), font: { color: colour("text"), size: 14, family: "Inter, sans-serif" } },
      marker: { size: map.hasDirection ? 2 : 6, opacity: 1, symbol: points.map((p) => (p.isMeasured ? "circle" : "circle-open")),
        color: points.map((p) => p.length_um), ...colours } },
  ];
}

/** Shaft and two barbs of each arrow. */
function shafts({ points, factor }) {
  return coordinates(points.flatMap(({ at_mm, error_um }) => {
    const way = error_um.map((v) => (v * factor) / 1000);
    const tip = at_mm.map((v, i) => v + way[i]);
    const side = across(way);
    const barb = (sign) => tip.map((v, i) => v - BARB * way[i] + sign * BARB_WIDTH * side[i]);
    return [at_mm, tip, null, barb(1), tip, barb(-1), null];
  }));
}

/** A vector across another, as long as it is. */
function across(way) {
  const length = Math.hypot(...way);
  const least = way.map(Math.abs).indexOf(Math.min(...way.map(Math.abs)));
  const axis = [0, 1, 2].map((i) => (i === least ? 1 : 0));
  const cross = [0, 1, 2].map((i) => way[(i + 1) % 3] * axis[(i + 2) % 3] - way[(i + 2) % 3] * axis[(i + 1) % 3]);
  const size = Math.hypot(...cross) || 1;
  return cross.map((v) => (v * length) / size);
}

function spoken({ at_mm, error_um, length_um, expanded_um }) {
  const place = at_mm.map((v, i) => `${"XYZ"[i]} ${quantity(v, "travel")}`).join(", ");
  const parts = error_um.map((v, i) => `δ${"xyz"[i]} ${quantity(v, "gap")} ± ${quantity(expanded_um[i], "gap")}`);
  return [place, quantity(length_um, "gap"), ...parts].join("<br>");
}
