/* A planned path in space with the tracker that looks at it: how much of it is chosen. */
import { colour } from "./css-colour.js";
import { boxEdges, boxTrace, coordinates, drawScene, edges } from "./scene.js";

const TRACE = { rest: 1, chosen: 2, sights: 3, tool: 4, boxes: 6 };

/** Draw a plan; answers {choose(rows), keepOut(boxes), close}.
 *
 * rows: [{at_mm, tracker_mm}, …], X, Y and Z of the axes and where the tracker stands; none before there is a plan
 * travel: of X, Y and Z; offset_mm: of the reflector on the tool; boxes: that are kept clear
 */
export async function drawPlanSpace(element, { rows, travel, offset_mm, boxes }, chosen) {
  const stands = rows.filter((row, i) => row.tracker_mm !== rows[i - 1]?.tracker_mm).map((row) => row.tracker_mm);
  const around = travel.map(([low, high], i) => {
    const all = [low, high, low + offset_mm[i], high + offset_mm[i], ...stands.map((place) => place[i])];
    return [Math.min(...all), Math.max(...all)];
  });
  const base = { type: "scatter3d", hoverinfo: "skip", showlegend: false };
  const line = (name, width, dash) => ({ color: colour(name), width, dash });
  const parts = cut(chosen);
  const scene = await drawScene(element, [
    { ...base, mode: "lines", line: line("line-strong", 1.5), ...edges(travel) },
    { ...base, mode: "lines", line: line("plan", 1.5), ...parts[0] },
    { ...base, mode: "lines", line: line("accent", 4), ...parts[1] },
    { ...base, mode: "lines", opacity: 0.55, line: line("trace-y", 1), ...parts[2] },
    { ...base, mode: "lines+markers", line: line("text", 6), marker: { size: [1, 5], color: colour("text") }, ...parts[3] },
    { ...base, mode: "markers", marker: { size: 8, symbol: "diamond", color: colour("trace-y") }, ...coordinates(stands) },
    boxTrace(boxes),
  ], around);

  /** What is left out, what is driven, the beams to its stops, the tool at its end. */
  function cut(count) {
    const reflector = ({ at_mm }) => at_mm.map((v, i) => v + offset_mm[i]);
    const driven = rows.slice(0, count);
    const end = driven.at(-1);
    const places = (some) => some.map((row) => row.at_mm);
    return [places(rows.slice(Math.max(0, count - 1))), places(driven), driven.flatMap((row) => [row.tracker_mm, reflector(row), null]),
      end ? [end.at_mm, reflector(end)] : []].map(coordinates);
  }

  return {
    choose(count) {
      const next = cut(count);
      const along = (name) => next.map((part) => part[name]);
      scene.restyle({ x: along("x"), y: along("y"), z: along("z") }, [TRACE.rest, TRACE.chosen, TRACE.sights, TRACE.tool]);
    },
    keepOut(next) {
      const { x, y, z, text } = boxEdges(next);
      scene.restyle({ x: [x], y: [y], z: [z], text: [text] }, [TRACE.boxes]);
    },
    close: scene.close,
  };
}
