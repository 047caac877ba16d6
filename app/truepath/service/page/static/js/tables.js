/* Error tables of a result, named and ordered for people. */
import { t } from "./texts.js";

const TRANSLATIONS = "XYZ";
const ROTATIONS = "ABC";

/** Error motions of a result by axis: [{axis, tables: [table, …]}, …], known or not.
 *
 * table: {symbol, axis, name, kind, positionKind, positions, values, uncertainties, known,
 *         extrapolated: whether each position lies beyond what was measured; measured: that range or null,
 *         halves: half the difference of both directions of approach, null where there is none}
 */
export function tablesByAxis(result) {
  const entries = result.error_tables ?? {};
  const ways = result.direction?.half_difference ?? {};
  const ranges = result.measured_range ?? {};
  const axes = Object.keys(result.machine?.axes ?? {}).sort(byLetter("XYZABC"));
  return axes.map((axis) => ({
    axis,
    tables: [...TRANSLATIONS + ROTATIONS].map((motion) => `E${motion}${axis}`)
      .map((symbol) => read(symbol, entries[symbol] ?? {}, ways[symbol], ranges[axis])).sort(byMotion(axis)),
  }));
}

function read(symbol, entry, way, range) {
  const kind = TRANSLATIONS.includes(symbol[1]) ? "error" : "angle";
  const rotary = Boolean(entry.position_deg);
  const values = entry.value_um ?? entry.value_urad ?? [];
  return {
    symbol, axis: symbol[2], name: nameOf(symbol), kind,
    positionKind: rotary ? "turn" : "travel",
    positions: entry.position_mm ?? entry.position_deg ?? [],
    values,
    uncertainties: entry.uncertainty_um ?? entry.uncertainty_urad ?? [],
    extrapolated: entry.extrapolated ?? [],
    measured: range ? [range.from_mm ?? range.from_deg, range.to_mm ?? range.to_deg] : null,
    halves: way ? way.value_um ?? way.value_urad : null,
    known: values.length > 0 && values.every((v) => v !== null),
  };
}

/** What any symbol of a result stands for, in words. */
export const nameOfAny = (symbol) => (symbol[1] === "0" || symbol[0] !== "E" ? squarenessName(symbol) : nameOf(symbol));

/** What an error motion is, in words. */
export function nameOf(symbol) {
  const [, motion, axis] = symbol;
  if (ROTATIONS.includes(axis)) return rotaryName(motion, axis);
  if (motion === axis) return t("error.positioning", { axis });
  if (TRANSLATIONS.includes(motion)) return t("error.straightness", { axis, along: motion });
  const about = TRANSLATIONS[ROTATIONS.indexOf(motion)];
  return t(about === axis ? "error.roll" : "error.tilt", { axis, about });
}

function rotaryName(motion, axis) {
  if (motion === axis) return t("error.angular_positioning", { axis });
  if (TRANSLATIONS.includes(motion)) return t("error.shift", { axis, along: motion });
  return t("error.tilt", { axis, about: TRANSLATIONS[ROTATIONS.indexOf(motion)] });
}

/** Squareness and location errors of a result: [{symbol, name, kind, value, uncertainty}, …]. */
export function singleErrors(result) {
  const squareness = Object.entries(result.squareness_urad ?? {}).map(([symbol, entry]) =>
    ({ symbol, name: squarenessName(symbol), kind: "angle", ...entry }));
  const locations = Object.entries(result.axis_location ?? {}).map(([symbol, entry]) =>
    ({ symbol, name: squarenessName(symbol),
      kind: entry.value_um === undefined ? "angle" : "error",
      value: entry.value_um ?? entry.value_urad,
      uncertainty: entry.uncertainty_um ?? entry.uncertainty_urad }));
  return [...squareness, ...locations];
}

/** What a squareness or location error is between: C0Y is Y to X. */
export function squarenessName(symbol) {
  const [motion, , axis] = symbol;
  if (!TRANSLATIONS.includes(axis)) return t("error.location", { axis });
  const about = TRANSLATIONS[ROTATIONS.indexOf(motion)];
  const other = [...TRANSLATIONS].find((letter) => letter !== axis && letter !== about);
  return t("error.squareness", { axis, other });
}

const byLetter = (order) => (a, b) => order.indexOf(a) - order.indexOf(b);

/** Positioning and roll first, then the others in the order X Y Z, A B C. */
function byMotion(axis) {
  const own = TRANSLATIONS.includes(axis) ? ROTATIONS[TRANSLATIONS.indexOf(axis)] : axis;
  const rank = ({ symbol: [, motion] }) => {
    const group = TRANSLATIONS.includes(motion) ? 0 : 10;
    return group + (motion === axis || motion === own ? 0 : 1 + "XYZABC".indexOf(motion) % 3);
  };
  return (a, b) => rank(a) - rank(b);
}
