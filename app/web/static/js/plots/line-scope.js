/* How far points of the tracker lie beside the straight line that they form. */

const STILL_MM_S = 2;
const BREAK_S = 0.5; // points come each 0.1 s
const BEND_MM = 0.3; // no machine is as crooked within one line
const FEWEST = 5; // fewer points are too near to any line

/** Follows the points of one straight line after the other.
 *
 * `add(time_s, point_mm, isCurved)` answers {isBreak, line_um}: whether points are missing before
 * this one, and the distances of all points since the line began from the line fitted to them,
 * this one last; empty while the target stands, too few points are there, or the way is no line.
 */
export function createLineScope() {
  let points = [];
  let last = null;

  function add(time_s, point_mm, isCurved = false) {
    const step_s = last ? time_s - last.time_s : Infinity;
    const isBreak = Boolean(last) && step_s > BREAK_S;
    const isStill = last !== null && !isBreak && distance(point_mm, last.point_mm) < STILL_MM_S * step_s;
    last = { time_s, point_mm };
    if (isBreak || isStill || isCurved) points = [];
    if (isStill || isCurved) return { isBreak, line_um: [] };
    if (points.length >= FEWEST && beside(point_mm, fitLine(points)) > BEND_MM) points = [];
    points.push(point_mm);
    if (points.length < FEWEST) return { isBreak, line_um: [] };
    const line = fitLine(points);
    return { isBreak, line_um: points.map((point) => 1e3 * beside(point, line)) };
  }

  return { add };
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
