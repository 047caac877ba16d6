/* Where the plan wants the tracker, what each station brings, and what is advised. */
import { h, write } from "../dom.js";
import { card, fold, pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { nameOf } from "../tables.js";
import { duration, known, number, t } from "../texts.js";
import { quantity } from "../units.js";

/** A place as coordinates with their axes. */
export const placeText = (position_mm) =>
  ["X", "Y", "Z"].map((name, i) => `${name} ${quantity(position_mm[i], "travel")}`).join(", ");

/** A card for a plan that chose the tracker's place; null for any other. */
export function adviceCard(plan) {
  if (!plan?.place) return null;
  const { tracker, stations, at_stations: several } = plan.place;
  const named = several
    ? several.map((one, i) => [t("advice.station", { number: number(i + 1) }), after(one)])
    : [[t("advice.place"), placeText(tracker.position_mm)]];
  const advised = t(stations.recommended > 1 ? "advice.several" : "advice.one", { count: number(stations.recommended) });
  return card(t("advice.title"), pairs(named), h("p", { class: "advised" }, advised),
    pairs(stations.options.map((option) => [optionName(option), worth(option)])),
    h("p", { class: "field-note" }, t("advice.note", { k: COVERAGE, minutes: number(stations.move_minutes) })));
}

/** A card that says how much of a prediction is the tracker's, and what takes it away; null for a perfect tracker. */
export function settleCard(predicted) {
  const errors = predicted?.tracker_errors;
  if (!errors) return null;
  const values = { random: expanded(errors.random_um), all: quantity(predicted.expanded_volumetric_uncertainty_um, "gap") };
  const leaves = (one) => t("settle.leaves", { u: quantity(one.expanded_volumetric_uncertainty_um, "gap"), minutes: number(one.minutes) });
  const { element, value } = fold("settle", t("settle.title"), h("p", {}, t("settle.share", values)),
    pairs(errors.remedies.map((one) => [t(`settle.${one.change}`, { place: placeText(one.position_mm), turn: number(one.turn_deg) }), leaves(one)])),
    h("p", { class: "field-note" }, t("settle.note", { k: COVERAGE })));
  const [best] = errors.remedies;
  write(value, best ? t("settle.best", { leaves: leaves(best) }) : "");
  return element;
}

const after = ({ position_mm, duration_s, volumetric_uncertainty_um: left }) => [
  placeText(position_mm), h("br"),
  h("span", { class: "quiet" }, t("advice.after", { time: duration(duration_s), u: expanded(left) })),
];

const expanded = (um) => quantity(COVERAGE * um, "gap");

const optionName = ({ count, minutes }) =>
  t(count > 1 ? "advice.option" : "advice.option_one", { count: number(count), minutes: number(minutes) });

/** What a number of stations leaves, and against one place that measures as long. */
function worth({ count, volumetric_uncertainty_um: left, one_place_as_long: stay, pays, because }) {
  const u = `U = ${expanded(left)}`;
  if (count === 1) return u;
  const values = { stay: expanded(stay.volumetric_uncertainty_um), reason: pays ? reasonOf(because) : "" };
  return [u, h("br"), h("span", { class: "quiet" }, t(pays ? "advice.pays" : "advice.pays_not", values))];
}

const reasonOf = (because) =>
  known(`advice.because_${because}`, t("advice.because_weak", { error: because, name: nameOf(because) }));
