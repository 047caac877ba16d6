/* How far points of the tracker lie beside the line that the machine drives. */

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
export function createLineScope() {
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
export function fitLine(points) {
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
