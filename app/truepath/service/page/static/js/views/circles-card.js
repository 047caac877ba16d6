/* Circles that a verification drove on the fly (ISO 230-4): a polar chart of each, and its figures. */
import { h, icon, s } from "../dom.js";
import { term } from "../glossary.js";
import { card, notice, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { number, t } from "../texts.js";
import { figure, quantity, shown, stored, unitOf } from "../units.js";

const FIGURES = ["H", "G", "G_counterclockwise", "G_clockwise", "F_max", "F_min"];

/** The card of all circles; null where the verification drove none. */
export function circlesCard({ circles_in_motion: circles = [], circles_missing: missing = [] }) {
  if (!circles.length && !missing.length) return null;
  const lost = missing.length > 0 && notice("held", t("circles.missing"), t("circles.missing_text", { rows: missing.map((row) => number(row + 1)).join(", ") }));
  const element = card(t("circles.title"), h("p", { class: "quiet" }, t("circles.text", { k: COVERAGE }), " ", term("circle")), lost, circles.map(circleSection));
  element.dataset.card = "circles";
  return element;
}

function circleSection(circle) {
  const drawing = circle.centre_um ? drawn(circle) : null;
  const unlike = FIGURES.filter((name) => circle.difference_um[name]?.within === false);
  return h("section", { class: "circle", "data-plane": circle.plane }, h("h3", {}, nameOf(circle)),
    h("div", { class: "circle-sides" }, drawing ? drawing.chart : h("p", { class: "quiet" }, t("circles.no_centre")),
      h("div", {}, figuresTable(circle),
        unlike.length > 0 && h("p", {}, h("span", { class: "changed" }, icon("warning"), t("circles.unlike", { figures: unlike.map(symbolOf).join(", ") }))),
        h("p", { class: "quiet" }, t("circles.driven", { feeds: Object.entries(circle.driven_feed_mm_min).map(([sense, feed]) => `${t(`circles.${sense}`)} ${quantity(feed, "feed")}`).join(", ") })))),
    drawing && drawing.table);
}

const nameOf = ({ plane, diameter_mm, feed_mm_min }) =>
  t("circles.name", { plane, diameter: quantity(diameter_mm, "length", 1), feed: quantity(feed_mm_min, "feed") });

const symbolOf = (name) => {
  const [letter, of] = name.split("_");
  return SENSES.includes(of) ? `${letter} ${t(`circles.${of}`)}` : [letter, of].filter(Boolean).join(" ");
};

/** The chart with its key, and the same numbers as a table. */
function drawn(circle) {
  const { angle_deg, centre_um } = circle;
  const measured = aboutCentre(circle.radial_um, centre_um.measured, angle_deg);
  const predicted = aboutCentre(circle.predicted_radial_um, centre_um.predicted, angle_deg);
  const stated = FIGURES.filter((name) => name in circle.figures_um).map((name) => `${symbolOf(name)} ${expanded(circle.figures_um, circle.uncertainty_um, name)} ${unitOf("error")}`);
  const { element, step_um, factor } = drawCircle(circle, measured, predicted, t("circles.label", { name: nameOf(circle), figures: stated.join("; ") }));
  const senses = SENSES.filter((sense) => measured[sense]);
  return {
    chart: h("figure", { class: "circle-figure" }, element,
      h("figcaption", {}, h("span", { class: "circle-key" }, [...senses, "predicted"].map((name) => h("span", {}, sample(name), t(`circles.${name}`)))),
        h("span", { class: "quiet" }, t("circles.scale", { step: quantity(step_um, "error"), factor: number(Number(factor.toPrecision(2))) })))),
    table: h("details", { class: "map-table" }, h("summary", {}, t("circles.table")), angleTable(circle, senses, measured, predicted)),
  };
}

const sample = (name) => s("svg", { class: "svg-chart", viewBox: "0 0 28 10", "aria-hidden": "true" }, s("path", { class: `trace is-${name}`, d: "M1 5H27" }));

const expanded = (values, sigmas, name) => (name in values ? `${figure(values[name], "error")} ± ${figure(COVERAGE * sigmas[name], "error")}` : "–");

function figuresTable(circle) {
  const names = FIGURES.filter((name) => name in circle.figures_um);
  const heads = ["measured", "noise", "by_result"].map((name) => h("th", { class: "right" }, t(`circles.${name}`)));
  return tableFrame(t("circles.figures", { name: nameOf(circle) }), h("table", { class: "circle-table" },
    h("thead", {}, h("tr", {}, h("th", {}, unitOf("error")), heads)),
    h("tbody", {}, names.map((name) => h("tr", { "data-figure": name }, h("th", { scope: "row" }, h("span", { class: "symbol" }, symbolOf(name))),
      h("td", { class: "right" }, expanded(circle.figures_um, circle.uncertainty_um, name)),
      h("td", { class: "right" }, figure(circle.by_the_noise_alone_um[name], "error")),
      h("td", { class: "right" }, expanded(circle.predicted_um, circle.predicted_uncertainty_um, name)))))));
}

/** What is drawn, in numbers: the deviation by angle, as measured and as predicted. */
function angleTable(circle, senses, measured, predicted) {
  const columns = [...senses.map((sense) => [t(`circles.${sense}`), measured[sense]]),
    ...senses.map((sense) => [t("circles.predicted_of", { sense: t(`circles.${sense}`) }), predicted[sense]])];
  return tableFrame(t("circles.by_angle", { name: nameOf(circle) }), h("table", {},
    h("caption", {}, t("circles.by_angle_note", { unit: unitOf("error") })),
    h("thead", {}, h("tr", {}, h("th", { class: "right" }, "°"), columns.map(([name]) => h("th", { class: "right" }, name)))),
    h("tbody", {}, circle.angle_deg.map((angle, i) => h("tr", {}, h("th", { scope: "row", class: "right" }, number(angle, 1)),
      columns.map(([, values]) => h("td", { class: "right" }, figure(values[i], "error"))))))));
}

const [SIZE, OUTER, NOMINAL] = [420, 166, 104]; // radii: of the outermost ring, of the nominal circle
const MOST_RINGS = 2.5; // on either side of the nominal circle
const LEAST_UM = 1e-3; // of a largest deviation, so that there is a scale
const MIDDLE = SIZE / 2;

/** Both senses, as the standard orders them. */
const SENSES = ["counterclockwise", "clockwise"];

/** Radius less the commanded one about a centre, by sense. */
function aboutCentre(radial_um, [u, v], angle_deg) {
  const off = angle_deg.map((deg) => u * Math.cos(deg * (Math.PI / 180)) + v * Math.sin(deg * (Math.PI / 180)));
  return Object.fromEntries(Object.entries(radial_um).map(([sense, values]) => [sense, values.map((value, i) => value - off[i])]));
}

/** Draw a circle; answers {element, step_um, factor}: the rings' distance, and how far the deviation is exaggerated.
 *
 * circle: {plane, diameter_mm, angle_deg}; measured, predicted: deviation about the centre by sense, µm; label: for those who cannot see it
 */
function drawCircle({ plane, diameter_mm, angle_deg }, measured, predicted, label) {
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
