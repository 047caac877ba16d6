/* mm or inch on the screen; what is stored and sent is metric always. */
import { preference } from "./preferences.js";
import { number } from "./texts.js";

const INCH_MM = 25.4;
const MICROINCH_UM = 0.0254;

const inch = () => preference("units") === "inch";

/** Kinds of quantity: factor from the stored unit, name shown, decimals. */
const KINDS = {
  length: () => (inch() ? [1 / INCH_MM, "in", 4] : [1, "mm", 3]),
  travel: () => (inch() ? [1 / INCH_MM, "in", 2] : [1, "mm", 0]),
  distance: () => (inch() ? [1 / (12 * INCH_MM), "ft", 1] : [1e-3, "m", 2]),
  feed: () => (inch() ? [1 / INCH_MM, "in/min", 1] : [1, "mm/min", 0]),
  error: () => (inch() ? [1 / MICROINCH_UM, "µin", 0] : [1, "µm", 1]),
  gap: () => (inch() ? [1 / MICROINCH_UM, "µin", 1] : [1, "µm", 2]),
  angle: () => [1, "µrad", 1],
  turn: () => [1, "°", 3],
  minutes: () => [1, "min", 1],
};

/** Name of the unit a kind is shown in. */
export const unitOf = (kind) => KINDS[kind]()[1];

/** A stored value as the number shown. */
export const shown = (value, kind) => value * KINDS[kind]()[0];

/** A shown number as the value stored. */
export const stored = (value, kind) => value / KINDS[kind]()[0];

/** Digits after the decimal sign. */
export const decimalsOf = (kind) => KINDS[kind]()[2];

/** A stored value as text without its unit. */
export function figure(value, kind, decimals) {
  const [factor, , usual] = KINDS[kind]();
  if (value === null || value === undefined) return "–";
  return number(value * factor, decimals ?? usual);
}

/** A stored value as text with its unit. */
export const quantity = (value, kind, decimals) =>
  `${figure(value, kind, decimals)} ${unitOf(kind)}`;
