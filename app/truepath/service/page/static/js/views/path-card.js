/* The card with the path in space, as Check and Run show it. */
import { h, mark } from "../dom.js";
import { segments } from "../parts.js";
import { colour } from "../plots/colours.js";
import { boxTrace, coordinates, drawScene, edges, VIEWS } from "../plots/scene.js";
import { t } from "../texts.js";
import { quantity } from "../units.js";

/** A card that draws the plan as soon as it is there; `progress` and `close` as the plot's. */
export function pathCard(live) {
  const view = h("div", { class: "path-view", role: "img", "aria-label": t("path.title") });
  const missing = h("div", { class: "path-view path-missing" }, t("path.waiting"));
  const tools = h("div", { class: "path-tools", hidden: true });
  const key = legend(live);
  const element = h("section", { class: `card path-card${live ? " is-live" : ""}` },
    key, missing, view, tools);
  mark(view, "hidden", "");
  let plan = null;
  let plot = null;
  let reached = null; // told before the picture is there, and of an ended job never again
  let closed = false;

  async function draw(next, machine) {
    plan = next;
    missing.hidden = true;
    view.hidden = false;
    if (plan.keep_out?.length) key.append(entry("box", t("keepout.title")));
    const drawn = await drawPath(view, plan, machine);
    if (closed) drawn.close();
    else show(drawn);
  }

  function show(drawn) {
    plot = drawn;
    if (reached) plot.progress(...reached);
    view.dataset.drawn = "";
    tools.append(segments(t("path.view"), VIEWS.map((name) => [name, t(`path.${name}`)]), "iso",
      plot.view, true));
    tools.hidden = false;
  }

  return {
    element,
    update(next, machine) {
      if (next && !plan) draw(next, machine);
    },
    progress(done, position) {
      reached = [done, position];
      plot?.progress(done, position);
    },
    close() {
      closed = true;
      plot?.close();
    },
  };
}

const entry = (name, text) => h("li", { class: `is-${name}` }, h("i"), text);

function legend(live) {
  return h("ul", { class: "path-legend" }, entry("planned", t("path.planned")),
    live && [entry("done", t("path.done")), entry("now", t("path.now"))]);
}

const REDRAW_MS = 250;
const TRACE = { plan: 1, done: 2, now: 3 };

/** Columns of X, Y and Z among the axes of a plan; -1 where the machine has none. */
const linear = (axes) => ["X", "Y", "Z"].map((name) => axes.indexOf(name));

const pick = (row, columns) => columns.map((c) => (c < 0 ? 0 : row[c]));

function traces(rows, travel, standing, boxes) {
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
  ];
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
async function drawPath(element, plan, machine) {
  const columns = linear(plan.axes);
  const rows = plan.position.map((row) => pick(row, columns));
  const travel = travelOf(machine, rows);
  const standing = !plan.feed_mm_min?.length;
  const scene = await drawScene(element, traces(rows, travel, standing, plan.keep_out ?? []), travel, true);

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
