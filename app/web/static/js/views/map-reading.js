/* The volumetric error for drawing: on a grid of the service, or at the places of a verification. */
import { COVERAGE } from "../plots/error-chart.js";

export const LINEAR = ["X", "Y", "Z"];

/** A map of the service for drawing; `result` says which range was measured.
 *
 * columns: those of X, Y and Z in a position
 * points: [{index, at_mm, error_um, expanded_um, length_um, isMeasured}, …]
 */
export function readMap(found, result) {
  const columns = LINEAR.map((name) => found.axes.indexOf(name));
  const pick = (row) => columns.map((c) => row[c]);
  const places = found.position.map(pick);
  const levels = columns.map((_, i) => [...new Set(places.map((at) => at[i]))].sort((a, b) => a - b));
  return {
    columns, count: found.points, isScattered: false, levels, hasDirection: found.error_um.some((error) => error.some(Boolean)),
    travel: levels.map((own) => [own[0], own.at(-1)]),
    measured: LINEAR.map((name) => rangeOf(result.measured_range?.[name])),
    points: places.map((at_mm, i) => ({
      at_mm, index: at_mm.map((v, k) => levels[k].indexOf(v)),
      error_um: found.error_um[i], expanded_um: found.uncertainty_um[i].map((u) => COVERAGE * u),
      length_um: found.length_um[i], isMeasured: found.is_measured[i],
    })),
  };
}

const rangeOf = (range) => (range ? [range.from_mm, range.to_mm] : null);

/** What a verification has measured where the machine stood still, in the travel of a map; the places lie on no grid. */
export function readPlaces({ places }, map) {
  const points = places.position.map((position, i) => ({
    at_mm: map.columns.map((c) => position[c]), error_um: places.measured_um[i],
    expanded_um: places.measured_uncertainty_um[i].map((u) => COVERAGE * u),
    length_um: Math.hypot(...places.measured_um[i]), isMeasured: true,
  }));
  return { ...map, isScattered: true, hasDirection: true, points: points.filter((_, i) => places.standstill[i]) };
}
