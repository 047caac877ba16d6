/* The path in space: what is planned, what is done, where the machine is. */
import { quantity, shown, unitOf } from "../units.js";
import { colour } from "./colours.js";

const SCRIPT = "/assets/plotly.min.js";
const REDRAW_MS = 250;
const ZOOM = 1.3;
const TRACE = { plan: 1, done: 2, now: 3 };
const VIEWS = {
  iso: { eye: { x: 1.35, y: -1.55, z: 0.95 }, up: { x: 0, y: 0, z: 1 } },
  top: { eye: { x: 0, y: 0, z: 2.2 }, up: { x: 0, y: 1, z: 0 } },
  front: { eye: { x: 0, y: -2.2, z: 0 }, up: { x: 0, y: 0, z: 1 } },
  side: { eye: { x: 2.2, y: 0, z: 0 }, up: { x: 0, y: 0, z: 1 } },
};

let loading = null;

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

/** Columns of X, Y and Z among the axes of a plan; -1 where the machine has none. */
const linear = (axes) => ["X", "Y", "Z"].map((name) => axes.indexOf(name));

const pick = (row, columns) => columns.map((c) => (c < 0 ? 0 : row[c]));

function coordinates(points) {
  const column = (i) => points.map((point) => shown(point[i], "length"));
  return { x: column(0), y: column(1), z: column(2) };
}

/** The twelve edges of the axis travel, broken by nulls. */
function edges(travel) {
  const corner = (bits) => [0, 1, 2].map((i) => travel[i][(bits >> i) & 1]);
  const points = { x: [], y: [], z: [] };
  for (let a = 0; a < 8; a += 1) {
    for (const bit of [1, 2, 4]) {
      if (a & bit) continue;
      for (const p of [corner(a), corner(a | bit), [null, null, null]]) {
        points.x.push(p[0] === null ? null : shown(p[0], "length"));
        points.y.push(p[1] === null ? null : shown(p[1], "length"));
        points.z.push(p[2] === null ? null : shown(p[2], "length"));
      }
    }
  }
  return points;
}

function traces(rows, travel, standing) {
  const base = { type: "scatter3d", hoverinfo: "skip", showlegend: false };
  const line = (name, width) => ({ color: colour(name), width });
  const dots = { size: 3.5, color: colour("plan") };
  return [
    { ...base, mode: "lines", line: line("line-strong", 1.5), ...edges(travel) },
    { ...base, mode: standing ? "lines+markers" : "lines", marker: dots,
      line: line("plan", standing ? 1.5 : 2.5), ...coordinates(rows) },
    { ...base, mode: "lines", line: line("accent", 6), x: [], y: [], z: [] },
    { ...base, mode: "markers", x: [], y: [], z: [],
      marker: { size: 6, color: colour("text"), line: { color: colour("panel"), width: 2 } } },
  ];
}

function layout(travel, frame) {
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
      xaxis: axis("X", 0), yaxis: axis("Y", 1), zaxis: axis("Z", 2), aspectmode: "manual", aspectratio: proportions(travel, frame),
      camera: { ...VIEWS.iso, projection: { type: "orthographic" } },
    },
    uirevision: "kept",
  };
}

/** True proportions, as large as the frame allows in any view. */
function proportions(travel, frame) {
  const size = travel.map(([low, high]) => high - low || 1);
  const narrow = Math.min(1, frame.clientWidth / frame.clientHeight / 1.25);
  const scale = (ZOOM * narrow) / Math.cbrt(size[0] * size[1] * size[2]);
  return { x: size[0] * scale, y: size[1] * scale, z: size[2] * scale };
}

function padded([low, high]) {
  const margin = 0.04 * (high - low || 1);
  return [low - margin, high + margin];
}

/** Travel of X, Y and Z: of the machine, widened to the plan. */
function travelOf(machine, rows) {
  return ["X", "Y", "Z"].map((name, i) => {
    const axis = machine?.axes?.[name];
    const values = rows.map((row) => row[i]);
    if (axis?.min_mm !== undefined) values.push(axis.min_mm, axis.max_mm);
    return [Math.min(...values), Math.max(...values)];
  });
}

/** Draw a plan in `element`; answers {progress, view, close}.
 *
 * progress(done, position): rows reached and the axis positions now, or null
 */
export async function drawPath(element, plan, machine) {
  const Plotly = await plotly();
  const columns = linear(plan.axes);
  const rows = plan.position.map((row) => pick(row, columns));
  const travel = travelOf(machine, rows);
  const options = { displayModeBar: false, responsive: true, scrollZoom: true };
  const standing = !plan.feed_mm_min?.length;
  await Plotly.newPlot(element, traces(rows, travel, standing), layout(travel, element), options);

  const name = element.getAttribute("aria-label");
  let wanted = null;
  let drawn = "";
  const timer = setInterval(redraw, REDRAW_MS);

  function redraw() {
    if (!wanted || document.hidden) return;
    const { done, position } = wanted;
    const at = position ? [pick(position, columns)] : [];
    const key = `${done} ${at}`;
    if (key === drawn) return;
    drawn = key;
    const parts = [[...at, ...rows.slice(done)], [...rows.slice(0, done), ...at], at].map(coordinates);
    const along = (name) => parts.map((part) => part[name]);
    Plotly.restyle(element, { x: along("x"), y: along("y"), z: along("z") },
      [TRACE.plan, TRACE.done, TRACE.now]);
    element.setAttribute("aria-label", [name, ...at.map(spoken)].join(": "));
  }

  return {
    progress(done, position) {
      wanted = { done: Math.max(0, Math.min(rows.length, done)), position };
    },
    view(name) {
      const camera = { ...VIEWS[name], projection: { type: "orthographic" } };
      Plotly.relayout(element, { "scene.camera": camera });
    },
    close() {
      clearInterval(timer);
      Plotly.purge(element);
    },
  };
}

const spoken = (at) =>
  at.map((value, i) => `${"XYZ"[i]} ${quantity(value, "length")}`).join(", ");
