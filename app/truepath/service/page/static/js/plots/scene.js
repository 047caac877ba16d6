/* Pictures in space: plotly.js where a graphics processor draws them, else flat; and the frame they share. */
import { ROOT } from "../api.js";
import { nameOfBox } from "../keep-out.js";
import { shown, unitOf } from "../units.js";
import { colour } from "./css-colour.js";
import { drawFlat } from "./flat-scene.js";

const SCRIPT = `${ROOT}/../../assets/plotly.min.js`;
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

const OPTIONS = { displayModeBar: false, responsive: true };
const BY_PROCESSOR = /swiftshader|llvmpipe|softpipe|software|basic render/i;

let loading = null;
let quick = null;

/** Draw traces over the travel of X, Y and Z in mm; answers {restyle, replace, view, close}.
 *
 * Without a graphics processor the first picture of plotly.js keeps the page, and ABORT with
 * it, from answering for seconds: there, and where plotly.js fails, the traces are drawn flat.
 * The wheel scrolls the page unless a picture has most of it for itself: `isZoomed`.
 */
export async function drawScene(element, traces, travel, isZoomed = false) {
  if (isSpaceQuick()) {
    try {
      return await drawInSpace(element, traces, travel, isZoomed);
    } catch (error) {
      console.warn("drawn flat:", error);
    }
  }
  const { look, ...flat } = drawFlat(element, traces, travel.map(padded), CAMERAS.iso.eye);
  return { ...flat, view: (name) => look(CAMERAS[name].eye) };
}

async function drawInSpace(element, traces, travel, isZoomed) {
  const Plotly = await plotly();
  const options = { ...OPTIONS, scrollZoom: isZoomed };
  await Plotly.newPlot(element, traces, layout(travel, element), options);
  // At the end of a line under the pointer plotly.js has no data coordinate to snap to: uniform3fv throws, and nothing is drawn any more.
  element._fullLayout.scene._scene.glplot.snapToData = false;
  return {
    restyle: (change, which) => Plotly.restyle(element, change, which),
    replace: (next) => Plotly.react(element, next, element.layout, options),
    view: (name) => Plotly.relayout(element, { "scene.camera": camera(name) }),
    close: () => Plotly.purge(element),
  };
}

/** plotly.js, once it is there. */
function plotly() {
  loading ??= new Promise((done, failed) => {
    const script = document.createElement("script");
    script.src = SCRIPT;
    script.addEventListener("load", () => done(window.Plotly));
    script.addEventListener("error", () => failed(new Error(SCRIPT)));
    document.head.append(script);
  });
  return loading;
}

/** Whether a graphics processor draws for this browser; asked once, as contexts are few. */
function isSpaceQuick() {
  quick ??= hasGraphicsProcessor();
  return quick;
}

function hasGraphicsProcessor() {
  const gl = document.createElement("canvas").getContext("webgl", { failIfMajorPerformanceCaveat: true });
  if (!gl) return false;
  const unmasked = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = gl.getParameter(unmasked ? unmasked.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return !BY_PROCESSOR.test(renderer);
}

/** The camera of a view. */
const camera = (view) => ({ ...CAMERAS[view], projection: { type: "orthographic" } });

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

/** A trace of the edges of keep-out boxes, each with its name at a corner. */
export const boxTrace = (boxes) => ({ type: "scatter3d", hoverinfo: "skip", showlegend: false, mode: "lines+text",
  line: { color: colour("fault"), width: 2.5 }, textfont: { color: colour("fault"), size: 14 }, ...boxEdges(boxes) });

/** What of that trace changes with the boxes. */
export function boxEdges(boxes) {
  const parts = boxes.map(({ min_mm, max_mm }) => edges(min_mm.map((low, i) => [low, max_mm[i]])));
  const along = (name) => parts.flatMap((part) => part[name]);
  return { x: along("x"), y: along("y"), z: along("z"), text: parts.flatMap(({ x }, at) => x.map((_, i) => (i ? "" : nameOfBox(boxes[at], at)))) };
}

/** Layout of a scene over the travel of X, Y and Z that fills a frame. */
function layout(travel, frame) {
  const axis = (name, i) => ({
    title: { text: `${name} (${unitOf("travel")})`, font: { size: 13 } },
    range: padded(travel[i]),
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

/** A range a little wider, in shown units. */
function padded(range_mm) {
  const [low, high] = range_mm.map((v) => shown(v, "length"));
  const margin = 0.04 * (high - low || 1);
  return [low - margin, high + margin];
}
