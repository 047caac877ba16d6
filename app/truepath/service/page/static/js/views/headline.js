/* The first line of a result: the volumetric error before and after, held against the tolerance of the machine and of its mean. */
import * as api from "../api.js";
import { h, icon, mark, write } from "../dom.js";
import { term } from "../glossary.js";
import { COVERAGE } from "../plots/error-chart.js";
import { wordProblem } from "../problems.js";
import { dateTime, t } from "../texts.js";
import { decimalsOf, figure, quantity, unitOf } from "../units.js";
import { keptTolerance, toleranceField } from "./tolerance-field.js";

const SHAPES = { within: "check", outside: "warning", undecided: "info" };
const WAIT_MS = 300;

/** The line; null where the result states no volumetric error. `proof`: promise of its newest verification, or null. */
export function headline(job, result, proof) {
  const { before, after_expected: after, both_directions: both, left_in_both_directions: left } = result.volumetric_error ?? {};
  if (!before || !after) return null;
  const judged = h("div", { class: "machine-tolerance", hidden: true });
  const decided = h("p", { class: "conformity", role: "status" });
  const element = h("section", { class: "card headline", "data-card": "headline", "aria-label": t("headline.title") },
    h("p", { class: "headline-line" }, value(before.mean, [term("volumetric"), " ", t("headline.before")]),
      h("span", { class: "headline-arrow", role: "img", "aria-label": t("headline.to") }, icon("next")), value(after.mean, t("headline.after")), verified(proof)),
    both && left && h("p", { "data-lost-motion": "" }, term("lost_motion"), " ", t("headline.lost", { before: sized(both.mean), left: sized(left.mean) })),
    judged,
    h("p", { class: "quiet" }, t("headline.note", { k: COVERAGE, largest: sized(before.largest), left: sized(after.largest) }), " ", wordScale(before.mean)),
    toleranceField("tolerance", t("headline.tolerance"), (tolerance_um) => {
      clearTimeout(due);
      if (!Number.isNaN(tolerance_um)) due = setTimeout(ask, WAIT_MS, tolerance_um);
    }), decided);
  let asked = null;
  let due = null;

  async function ask(tolerance_um) {
    asked = tolerance_um;
    let found = null;
    try {
      found = await api.volumetricError(job.id, tolerance_um);
    } catch (error) {
      api.expectProblem(error);
      if (asked === tolerance_um) write(decided, wordProblem(error).title);
      return;
    }
    if (asked === tolerance_um) show(found);
  }

  function show(found) {
    judged.hidden = found.machine_tolerance_um === null;
    judged.replaceChildren(...(judged.hidden ? [] : judgement(found, before.p95, after.p95)));
    mark(decided, "data-conformity", found.after_expected.conformity);
    decided.replaceChildren(...(found.tolerance_um === null ? [t("headline.no_tolerance")] : sentence(found)));
  }

  ask(keptTolerance());
  return element;
}

/** A place for what the newest measurement that proves this result has found; null where there can be none. */
function verified(proof) {
  if (!proof) return null;
  const place = h("span", { class: "headline-proof" });
  // Without it the line stands all the same.
  proof.then((newest) => (newest ? place.append(...describeProof(newest.verification, newest.job)) : place.remove()));
  return place;
}

function describeProof({ compensated, volumetric_error_um: { measured }, conformity }, other) {
  const when = dateTime(other.ended ?? other.created);
  const decided = conformity.measured;
  const words = [t(compensated ? "headline.left" : "headline.again", { when }),
    decided && t(`headline.proof_${decided.conformity}`, { tolerance: quantity(decided.tolerance_um, "gap", 1) })].filter(Boolean);
  return [h("span", { class: "headline-arrow", role: "img", "aria-label": t("headline.to") }, icon("next")),
    value({ value_um: measured.mean, uncertainty_um: measured.mean_uncertainty }, words.join(": "))];
}

const value = ({ value_um, uncertainty_um }, name) => h("span", { class: "headline-value" },
  h("strong", {}, figure(value_um, "gap", digits()), h("span", { class: "unit" }, unitOf("gap"))),
  h("span", { class: "headline-u" }, `± ${quantity(COVERAGE * uncertainty_um, "gap", digits())}`), h("small", {}, name));

/** What of the uncertainty all lengths have in common; earlier results do not state it. */
const wordScale = ({ scale_uncertainty_um: scale }) => (scale ? t("headline.scale", { scale: quantity(COVERAGE * scale, "gap", 2) }) : "");

const digits = () => decimalsOf("error");

const sized = ({ value_um, uncertainty_um }) =>
  `${figure(value_um, "gap", digits())} ± ${quantity(COVERAGE * uncertainty_um, "gap", digits())}`;

/** What 95 % of the places do against the tolerance of the machine, as measured and as expected after. */
function judgement({ machine_tolerance_um, before, after_expected: after }, measured, expected) {
  const row = (state, { conformity_p95: conformity }, size) => h("p", { class: "machine-conformity", "data-conformity": conformity },
    icon(SHAPES[conformity]), h("span", {}, h("strong", {}, t(`headline.${state}_${conformity}`)), " ", sized(size)));
  return [h("p", {}, t("headline.machine_tolerance", { tolerance: quantity(machine_tolerance_um, "gap", 1) })),
    row("p95_now", before, measured), row("p95_after", after, expected)];
}

function sentence({ before, after_expected: after, tolerance_um }) {
  const tolerance = quantity(tolerance_um, "gap", 1);
  const now = t(`headline.now_${before.conformity}`);
  return [icon(SHAPES[after.conformity]), h("span", {}, h("strong", {}, t(`headline.${after.conformity}`, { tolerance })), " ", now)];
}
