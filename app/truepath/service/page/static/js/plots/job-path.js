/* The path of a job in space: planned, driven so far, and where the axes are. */
import { quantity } from "../units.js";
import { colour } from "./css-colour.js";
import { boxTrace, coordinates, drawScene, edges } from "./scene.js";

const REDRAW_MS = 250;
const TRACE = { plan: 1, done: 2, now: 3 };

/** Columns of X, Y and Z among the axes of a plan; -1 where the machine has none. */
export const linear = (axes) => ["X", "Y", "Z"].map((name) => axes.indexOf(name));

/** Of a row the axes X, Y and Z; 0 where the machine has none. */
export const pickLinear = (row, columns) => columns.map((c) => (c < 0 ? 0 : row[c]));

function traces(rows, travel, standing, boxes, { tracker_mm, offset_mm }) {
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
    boxTrace(boxes),
    ...(tracker_mm ? [
      { ...base, mode: "lines", opacity: 0.55, line: line("trace-y", 1),
        ...coordinates(rows.flatMap((row) => [tracker_mm, row.map((v, i) => v + offset_mm[i]), null])) },
      { ...base, mode: "markers", marker: { size: 8, symbol: "diamond", color: colour("trace-y") }, ...coordinates([tracker_mm]) },
    ] : []),
  ];
}

/** Where the first reflector sits on the tool. */
export const offsetOf = (machine) => machine?.tool_offset_mm ?? Object.values(machine?.targets ?? {})[0]?.offset_mm ?? [0, 0, 0];

/** Travel of X, Y and Z: of the machine, widened to the plan. */
export function travelOf(machine, rows) {
  return ["X", "Y", "Z"].map((name, i) => {
    const axis = machine?.axes?.[name];
    const values = rows.map((row) => row[i]);
    if (axis?.min_mm !== undefined) values.push(axis.min_mm, axis.max_mm);
    return [Math.min(...values), Math.max(...values)];
  });
}

/** Draw a plan in `element`; answers {progress, view, close}.
 *
 * plan: also has `tracker_mm` where that is known, which is drawn with its beams; progress(done, position): rows reached and the axis positions now, or null
 */
export async function drawPath(element, plan, machine) {
  const columns = linear(plan.axes);
  const rows = plan.position.map((row) => pickLinear(row, columns));
  const travel = travelOf(machine, rows);
  const standing = !plan.feed_mm_min?.length;
  const seen = { tracker_mm: plan.tracker_mm, offset_mm: offsetOf(machine) };
  const room = travel.map((ends, i) => [...ends, ...(plan.tracker_mm ? [plan.tracker_mm[i]] : [])]).map((all) => [Math.min(...all), Math.max(...all)]);
  const scene = await drawScene(element, traces(rows, travel, standing, plan.keep_out ?? [], seen), room, true);

  const name = element.getAttribute("aria-label");
  let wanted = null;
  let drawn = "";
  const timer = setInterval(redraw, REDRAW_MS);

  function redraw() {
    if (!wanted || document.hidden) return;
    const { done, position } = wanted;
    const at = position ? [pickLinear(position, columns)] : [];
    const key = `${done} ${at}`;
    if (key === drawn) return;
    drawn = key;
    const parts = [[...at, ...rows.slice(done)], [...rows.slice(0, done), ...at], at].map(coordinates);
    const along = (name) => parts.map((part) => part[name]);
    scene.restyle({ x: along("x"), y: along("y"), z: along("z") }, [TRACE.plan, TRACE.done, TRACE.now]);
    element.setAttribute("aria-label", [name, ...at.map(spoken)].join(": "));
  }

  return {
    progress(done, position) {
      wanted = { done: Math.max(0, Math.min(rows.length, done)), position };
    },
    view: scene.view,
    close() {
      clearInterval(timer);
      scene.close();
    },
  };
}

const spoken = (at) =>
  at.map((value, i) => `${"XYZ"[i]} ${quantity(value, "length")}`).join(", ");
