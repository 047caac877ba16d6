/* The last half minute: how far the target was beside its line. */
import { number } from "../texts.js";
import { shown } from "../units.js";
import { colour } from "./css-colour.js";
import { axisStyle, drawFilling } from "./filling-chart.js";

const WINDOW_S = 30;
const REDRAW_MS = 200;
const LIMIT = 2000;
const LEAST_RANGE_UM = 10;

/** Draw a strip chart; answers {add(time_s, [x, y, z] in mm, way as of the scope), newest(), isCommanded(), close}. */
export function drawStrip(element) {
  const data = [[], []];
  const scope = createLineScope();
  let fresh = false;
  let isCommanded = false;
  const { chart, close } = drawFilling(element, data, options());
  const timer = setInterval(redraw, REDRAW_MS);

  function redraw() {
    if (!fresh || document.hidden) return;
    fresh = false;
    chart.setData(data);
  }

  function trim(time_s) {
    let old = 0;
    while (data[0].length - old > LIMIT || data[0][old] < time_s - WINDOW_S) old += 1;
    if (old) for (const column of data) column.splice(0, old);
  }

  /** The line is fitted anew with each point: all that is shown of it holds against the same fit. */
  function show(line_um) {
    const first = data[1].length - line_um.length;
    line_um.forEach((um, i) => {
      if (first + i >= 0) data[1][first + i] = shown(um, "error");
    });
  }

  return {
    add(time_s, position_mm, way) {
      if (data[0].length && time_s <= data[0].at(-1)) return;
      const found = scope.add(time_s, position_mm, way);
      isCommanded = found.isCommanded;
      data[0].push(time_s);
      data[1].push(null);
      show(found.line_um);
      trim(time_s);
      fresh = true;
    },
    /** As shown now, in the unit of the panel; null where there is none. */
    newest: () => data[1].at(-1) ?? null,
    /** Whether the newest point was held against the line that was commanded. */
    isCommanded: () => isCommanded,
    close() {
      clearInterval(timer);
      close();
    },
  };
}

function options() {
  const common = axisStyle();
  return {
    padding: [8, 6, 8, 0],
    scales: {
      x: { time: false, range: (_, low, high) => [Math.min(low, high - WINDOW_S), high] },
      y: { range: (_, low, high) => [0, Math.max(1.1 * (high ?? 0), shown(LEAST_RANGE_UM, "error"))] },
    },
    axes: [
      { ...common, show: false },
      { ...common, size: 48, space: 30, grid: { stroke: colour("line"), width: 1 },
        values: (_, marks) => marks.map((m) => number(m, Math.abs(m) < 1 && m ? 1 : 0)) },
    ],
    series: [{}, { stroke: colour("accent"), width: 2, points: { show: false }, pxAlign: 0, spanGaps: false }],
  };
}

const STILL_MM_S = 2;
const BREAK_S = 0.5; // points come each 0.1 s
const BEND_MM = 0.3; // no machine is as crooked within one line
const FEWEST = 5; // fewer points are too near to any line
const BEYOND_MM = 1; // the end of a line that a machine overshoots; another line is farther away
const FAR_MM = 10; // no machine is so far off: the tracker stands elsewhere than when it was placed

/** Follows the points of one straight line after the other.
 *
 * `add(time_s, point_mm, {isCurved, commanded})` answers {line_um, isCommanded}.
 * commanded: where the ends of the lines about now should be seen, null while nobody knows.
 * With them, line_um holds the distance of this point from the nearest of these lines. Without,
 * the distances of all points since the line began from the line fitted to them, this one last.
 * It is empty where points are missing before this one, the way is no line, too few points are
 * there, or the target stands and nobody knows where it should.
 */
function createLineScope() {
  let points = [];
  let last = null;

  function add(time_s, point_mm, { isCurved = false, commanded = null } = {}) {
    const step_s = last ? time_s - last.time_s : Infinity;
    const isBreak = last !== null && step_s > BREAK_S;
    const isStill = last !== null && !isBreak && distance(point_mm, last.point_mm) < STILL_MM_S * step_s;
    last = { time_s, point_mm };
    const off_mm = commanded ? besideAny(point_mm, commanded) : Infinity;
    const isCommanded = off_mm < FAR_MM;
    if (isBreak || isStill || isCurved || isCommanded) points = [];
    if (isCommanded) return { line_um: isBreak || isCurved ? [] : [1e3 * off_mm], isCommanded };
    return { line_um: isStill || isCurved ? [] : follow(point_mm), isCommanded };
  }

  function follow(point_mm) {
    if (points.length >= FEWEST && beside(point_mm, fitLine(points)) > BEND_MM) points = [];
    points.push(point_mm);
    if (points.length < FEWEST) return [];
    const line = fitLine(points);
    return points.map((point) => 1e3 * beside(point, line));
  }

  return { add };
}

/** Distance from the nearest of the lines from place to place. */
function besideAny(point, places) {
  return Math.min(...places.slice(1).map((end, i) => besideSegment(point, places[i], end)));
}

/** Distance from a line, or from its end far outside. */
function besideSegment(point, begin, end) {
  const direction = unit(end.map((v, i) => v - begin[i]));
  const along = dot(point.map((v, i) => v - begin[i]), direction);
  const length = distance(begin, end);
  if (along < -BEYOND_MM) return distance(point, begin);
  if (along > length + BEYOND_MM) return distance(point, end);
  return beside(point, { centre: begin, direction });
}

/** Centre and direction of the line of least squared distances: the first principal axis. */
function fitLine(points) {
  const centre = [0, 1, 2].map((i) => points.reduce((sum, point) => sum + point[i], 0) / points.length);
  const from = points.map((point) => point.map((v, i) => v - centre[i]));
  let direction = unit(from.at(-1).map((v, i) => v - from[0][i]));
  for (let k = 0; k < 4; k += 1) direction = unit(stretch(from, direction)); // points lie along it by far the most
  return { centre, direction };
}

/** The scatter matrix of points times a direction. */
function stretch(from, direction) {
  const sum = [0, 0, 0];
  for (const v of from) {
    const along = dot(v, direction);
    for (let i = 0; i < 3; i += 1) sum[i] += along * v[i];
  }
  return sum;
}

/** Distance of a point from a line. */
function beside(point, { centre, direction }) {
  const from = point.map((v, i) => v - centre[i]);
  const along = dot(from, direction);
  return Math.hypot(...from.map((v, i) => v - along * direction[i]));
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const unit = (v) => v.map((x) => x / (Math.hypot(...v) || 1));
