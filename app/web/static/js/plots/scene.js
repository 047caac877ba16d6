/* Pictures in space: plotly.js, loaded when one is shown, and the frame they share. */
import { shown, unitOf } from "../units.js";
import { colour } from "./colours.js";

const SCRIPT = "/assets/plotly.min.js";
const ZOOM = 1.3;
const SLENDER = 2.05; // diagonals of usual size from which a long box is shown smaller
const CAMERAS = {
  iso: { eye: { x: 1.35, y: -1.55, z: 0.95 }, up: { x: 0, y: 0, z: 1 } },
  top: { eye: { x: 0, y: 0, z: 2.2 }, up: { x: 0, y: 1, z: 0 } },
  front: { eye: { x: 0, y: -2.2, z: 0 }, up: { x: 0, y: 0, z: 1 } },
  side: { eye: { x: 2.2, y: 0, z: 0 }, up: { x: 0, y: 0, z: 1 } },
};

/** Names of the views that a camera can take. */
export const VIEWS = Object.keys(CAMERAS);

/** The wheel scrolls the page unless a picture has most of it for itself. */
export const OPTIONS = { displayModeBar: false, responsive: true };

let loading = null;
let space = null;

/** plotly.js, once it is there. */
export function plotly() {
  loading ??= new Promise((done, failed) => {
    const script = document.createElement("script");
    script.src = SCRIPT;
    script.addEventListener("load", () => done(window.Plotly));
    script.addEventListener("error", () => failed(new Error(SCRIPT)));
    document.head.append(script);
  });
  return loading;
}

/** Whether this browser draws in space at all; asked once, as contexts are few. */
export function hasWebGL() {
  space ??= Boolean(document.createElement("canvas").getContext("webgl"));
  return space;
}

/** The camera of a view. */
export const camera = (view) => ({ ...CAMERAS[view], projection: { type: "orthographic" } });

/** Columns of points in shown units: {x, y, z}; null breaks a line. */
export function coordinates(points) {
  const column = (i) => points.map((point) => (point === null ? null : shown(point[i], "length")));
  return { x: column(0), y: column(1), z: column(2) };
}

/** The twelve edges of the axis travel, as points broken by nulls. */
export function edges(travel) {
  const corner = (bits) => [0, 1, 2].map((i) => travel[i][(bits >> i) & 1]);
  const points = [];
  for (let a = 0; a < 8; a += 1) {
    for (const bit of [1, 2, 4]) if (!(a & bit)) points.push(corner(a), corner(a | bit), null);
  }
  return coordinates(points);
}

/** Layout of a scene over the travel of X, Y and Z that fills a frame. */
export function layout(travel, frame) {
  const axis = (name, i) => ({
    title: { text: `${name} (${unitOf("travel")})`, font: { size: 13 } },
    range: padded(travel[i].map((v) => shown(v, "length"))),
    gridcolor: colour("line"), zeroline: false, showbackground: false, nticks: 5,
    tickfont: { size: 12 }, showspikes: false, color: colour("quiet"),
  });
  return {
    margin: { l: 0, r: 0, t: 0, b: 0 },
    paper_bgcolor: "rgba(0,0,0,0)",
    font: { family: "Inter, sans-serif", color: colour("quiet") },
    scene: {
      xaxis: axis("X", 0), yaxis: axis("Y", 1), zaxis: axis("Z", 2),
      aspectmode: "manual", aspectratio: proportions(travel, frame), camera: camera("iso"),
    },
    uirevision: "kept",
  };
}

/** True proportions, as large as the frame allows in any view. */
function proportions(travel, frame) {
  const size = travel.map(([low, high]) => high - low || 1);
  const narrow = Math.min(1, frame.clientWidth / frame.clientHeight / 1.25);
  const usual = Math.cbrt(size[0] * size[1] * size[2]);
  const scale = (ZOOM * narrow) / Math.max(usual, Math.hypot(...size) / SLENDER);
  return { x: size[0] * scale, y: size[1] * scale, z: size[2] * scale };
}

function padded([low, high]) {
  const margin = 0.04 * (high - low || 1);
  return [low - margin, high + margin];
}
