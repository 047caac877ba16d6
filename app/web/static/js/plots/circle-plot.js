/* A circle driven on the fly as a polar chart: the radial deviation, far exaggerated, about the nominal circle. */
import { s } from "../dom.js";
import { number } from "../texts.js";
import { shown, stored } from "../units.js";

const [SIZE, OUTER, NOMINAL] = [420, 166, 104]; // radii: of the outermost ring, of the nominal circle
const MOST_RINGS = 2.5; // on either side of the nominal circle
const LEAST_UM = 1e-3; // of a largest deviation, so that there is a scale
const MIDDLE = SIZE / 2;

/** Both senses, as the standard orders them. */
export const SENSES = ["counterclockwise", "clockwise"];

/** Radius less the commanded one about a centre, by sense. */
export function aboutCentre(radial_um, [u, v], angle_deg) {
  const off = angle_deg.map((deg) => u * Math.cos(deg * (Math.PI / 180)) + v * Math.sin(deg * (Math.PI / 180)));
  return Object.fromEntries(Object.entries(radial_um).map(([sense, values]) => [sense, values.map((value, i) => value - off[i])]));
}

/** Draw a circle; answers {element, step_um, factor}: the rings' distance, and how far the deviation is exaggerated.
 *
 * circle: {plane, diameter_mm, angle_deg}; measured, predicted: deviation about the centre by sense, µm; label: for those who cannot see it
 */
export function drawCircle({ plane, diameter_mm, angle_deg }, measured, predicted, label) {
  const scale = scaleOf([...Object.values(measured), ...Object.values(predicted)].flat());
  const curve = (values, name) => s("path", { class: `trace is-${name}`, d: closed(angle_deg, values.map(scale.radius)) });
  const element = s("svg", { class: "svg-chart circle-plot", viewBox: `0 0 ${SIZE} ${SIZE}`, role: "img", "aria-label": label },
    rings(scale), axes(plane), Object.values(predicted).map((values) => curve(values, "predicted")),
    SENSES.filter((sense) => measured[sense]).map((sense) => curve(measured[sense], sense)), numbers(scale));
  return { element, step_um: scale.step_um, factor: (1000 * scale.perUm * diameter_mm) / 2 / NOMINAL };
}

/** Rings at round numbers of the unit shown, which hold all values. */
function scaleOf(values_um) {
  const largest = shown(Math.max(LEAST_UM, ...values_um.map(Math.abs)), "error");
  const rough = largest / MOST_RINGS;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = decade * [1, 2, 5, 10].find((one) => one * decade >= rough * (1 - 1e-9));
  const count = Math.ceil(largest / step - 1e-9);
  const perUm = (OUTER - NOMINAL) / stored(count * step, "error");
  return { step, count, perUm, step_um: stored(step, "error"), radius: (um) => NOMINAL + perUm * um };
}

const ringsOf = ({ count }) => Array.from({ length: 2 * count + 1 }, (_, i) => i - count);

function rings(scale) {
  return ringsOf(scale).map((i) => s("circle", { class: i ? "grid" : "base", fill: "none", cx: MIDDLE, cy: MIDDLE, r: scale.radius(i * scale.step_um) }));
}

function numbers(scale) {
  const digits = Math.max(0, -Math.floor(Math.log10(scale.step) + 1e-9));
  return ringsOf(scale).map((i) =>
    s("text", { class: "ring", x: MIDDLE + 4, y: MIDDLE - scale.radius(i * scale.step_um) - 3 }, number(i * scale.step, digits)));
}

function axes([across, up]) {
  const [low, high] = [MIDDLE - OUTER - 10, MIDDLE + OUTER + 10];
  return [s("line", { class: "grid", x1: low, x2: high, y1: MIDDLE, y2: MIDDLE }), s("line", { class: "grid", x1: MIDDLE, x2: MIDDLE, y1: low, y2: high }),
    s("text", { class: "axis", x: high + 4, y: MIDDLE + 5 }, `+${across}`), s("text", { class: "axis", x: MIDDLE - 6, y: low - 4, "text-anchor": "end" }, `+${up}`)];
}

/** Angles are from the first axis, to the right, towards the second, upwards. */
function closed(angle_deg, radii) {
  const points = angle_deg.map((deg, i) => {
    const angle = deg * (Math.PI / 180);
    return `${(MIDDLE + radii[i] * Math.cos(angle)).toFixed(2)} ${(MIDDLE - radii[i] * Math.sin(angle)).toFixed(2)}`;
  });
  return `M${points.join("L")}Z`;
}
