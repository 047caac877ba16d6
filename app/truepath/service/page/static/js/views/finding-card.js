/* One finding of a discovery: an effect with a name, or structure that is only described. */
import { h } from "../dom.js";
import { card, pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { currentLanguage, known, number, t } from "../texts.js";
import { shown, unitOf } from "../units.js";

const ENOUGH = 5; // log Bayes factor from which an effect counts as found

/** Unit by the ending of a parameter's name; longer endings first. */
const UNITS = Object.entries({
  um_per_m_K: () => [1, "µm/m/K"],
  um_per_m: () => [1, "µm/m"],
  um_per_s: () => [shown(1, "error"), `${unitOf("error")}/s`],
  urad_per_m: () => [1, "µrad/m"],
  ppm_per_K: () => [1, "ppm/K"],
  ppm_per_s: () => [1, "ppm/s"],
  urad: () => [1, "µrad"],
  rad: () => [1, "rad"],
  mm_s: () => [1, "mm/s"],
  um: () => [shown(1, "error"), unitOf("error")],
  mm: () => [shown(1, "length"), unitOf("length")],
  deg: () => [1, "°"],
  ms: () => [1, "ms"],
  hz: () => [1, "Hz"],
  s: () => [1, "s"],
});

/** How sure a name is. */
const GRADES = {
  certain: () => t("discover.certain"),
  likely: () => t("discover.likely"),
  possible: () => t("discover.possible"),
};

/** How sure, in a word; the evidence behind it at a touch. */
const graded = (grade, evidence) => h("details", { class: "graded", "data-grade": grade },
  h("summary", {}, GRADES[grade]()), h("p", {}, evidence));

/** An effect: numbers, cause, what to do, evidence. */
export function effectCard(effect) {
  const content = card(nameOf(effect), numbers(effect), facts(effect, effect.name));
  content.dataset.effect = effect.name;
  return content;
}

/** Structure without a name: what it depends on instead of a cause that is sure. */
export function structureCard(found) {
  const { structure, depends_on: on, description } = found;
  const title = description[0].toUpperCase() + description.slice(1);
  const quiet = h("p", { class: "quiet" }, t("discover.no_name"));
  const content = structure
    ? card(nameOf({ ...found, name: structure }), quiet, numbers(found), facts(found, structure, on))
    : card(t("discover.unnamed"), h("p", {}, title), quiet);
  content.dataset.structure = on.join(" ");
  return content;
}

/** What would tell an effect: a text for its key, or the remedy of its family. */
const tellsOf = ({ name, would_tell: key }) => (key === "other-target" ? t("unobservable.by_another")
  : known(`discover.tells.${key}`, known(`effect.${name}.remedy`, "")));

/** Effects that the Runs do not distinguish, folded; null where there are none. */
export function cannotTellCard(untold) {
  if (!untold.length) return null;
  const words = (one) => [t("discover.untold", { name: nameOf(one), others: [
    ...one.taken_by.map((by) => known(`discover.taker.${by}`, t("discover.taker.axis", { axis: by }))),
    ...one.indistinguishable_from.map(nameOf)].join(t("discover.taker.with")) }),
  tellsOf(one)].join(" ");
  const item = (one) => h("li", {}, currentLanguage() === "en" ? one.sentence : words(one));
  return h("details", { class: "card", "data-card": "cannot-tell" }, h("summary", {}, t("discover.cannot_tell")),
    h("p", { class: "quiet" }, t("discover.cannot_tell_text")), h("ul", {}, untold.map(item)));
}

/** Name and keys of an effect: "Backlash Y". */
export function nameOf({ name, axis, motion, by, plane, direction, circle, symbol, depends_on: on }) {
  const word = known(`effect.${name}`, name);
  if (on && direction) return t("effect.along", { name: word, direction });
  const where = motion ?? symbol ?? [axis, by, plane, direction, circle].filter(Boolean).join(" / ");
  return `${word} ${where}`.trim();
}

function numbers({ parameters, unit }) {
  return h("p", { class: "finding-numbers" }, numbersOf(parameters, unit).join("; "), " ",
    h("small", {}, t("discover.k", { k: COVERAGE })));
}

function facts({ evidence, grade, indistinguishable_from: alike, ...effect }, name, on = null) {
  const word = (what) => known(`effect.${name}.${what}`, effect[what]);
  const share = number(100 * evidence.share_of_gap, 0);
  const factor = number(evidence.log_bayes_factor, 0);
  const said = t("discover.share", { share, factor, least: ENOUGH });
  const isGraded = !on && grade in GRADES;
  const rows = [
    [t("discover.grade"), isGraded && graded(grade, said)],
    [t("discover.depends_on"), on?.map(dependence).join(", ")],
    [t("discover.cause"), word("cause")],
    [t("discover.looks_like"), word("looks_like")],
    [t("discover.remedy"), effect.is_small ? tooSmall(effect) : word("remedy")],
    [t("discover.evidence"), !isGraded && said],
    [t("discover.others"), alike.map(nameOf).join("; ") || t("discover.alone")],
  ];
  return pairs(rows.filter(([, value]) => value));
}

function tooSmall({ largest_um: most }) {
  return t("discover.too_small", { most: `${number(most, 2)} µm` });
}

/** What structure depends on: an axis, `t` the time, `v(X)` the speed of X. */
function dependence(on) {
  if (on === "t") return t("where.time");
  const speed = on.match(/^v\((\w+)\)$/);
  return speed ? t("where.speed", { of: speed[1] }) : t("where.position", { of: on });
}

/** Parameters with expanded uncertainties: ["width 6.39 ± 0.15 µm"]. */
function numbersOf(parameters, unit) {
  return Object.entries(parameters).map(([key, { value, uncertainty }]) => {
    const [ending, of] = UNITS.find(([suffix]) => key.endsWith(`_${suffix}`)) ?? [];
    const stem = ending ? key.slice(0, -ending.length - 1) : key;
    const [scale, sign] = (of ?? Object.fromEntries(UNITS)[unit])?.() ?? [1, ""];
    const all = Array.isArray(value)
      ? value.map((v, i) => `${"XYZ"[i]} ${withU(scale * v, scale * uncertainty[i])}`)
      : [withU(scale * value, scale * uncertainty)];
    return `${known(`parameter.${stem}`, stem.replaceAll("_", " "))} ${all.join(", ")} ${sign}`.trim();
  });
}

/** Two digits of the expanded uncertainty. */
function withU(value, standard) {
  const half = COVERAGE * standard;
  const digits = half > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(half)), 0), 4) : 1;
  return `${number(value, digits)} ± ${number(half, digits)}`;
}
