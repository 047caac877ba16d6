/* What a set-up is worth from its geometry alone, and what would make it better. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { isActive } from "../flow.js";
import { term } from "../glossary.js";
import { card, pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { nameOf } from "../tables.js";
import { number, t } from "../texts.js";
import { quantity } from "../units.js";

const SHAPES = { good: "check", usable: "info", poor: "warning" };

/** A card of a grade; null where there is none. */
export function gradeCard(grade) {
  if (!grade) return null;
  const { verdict } = grade;
  const expected = quantity(COVERAGE * grade.expected_uncertainty_um, "error");
  return card(t("grade.title"),
    h("p", { class: "grade", "data-verdict": verdict }, icon(SHAPES[verdict]),
      h("strong", {}, term("grade", `${number(grade.number, 2)}: ${t(`grade.${verdict}`)}`))),
    h("p", {}, t(`grade.${verdict}_means`), " ", t("grade.expected", { u: expected, k: COVERAGE })),
    remedies(grade));
}

/** The weak error motions, what helps each, and what the grade would be with the first. */
function remedies({ weakest, improved_number: improved }) {
  const weak = weakest.filter(({ remedy }) => remedy);
  if (!weak.length) return null;
  const rows = weak.map(({ error, remedy }, i) => [
    [t("grade.weak"), `${error}, ${nameOf(error)}`], [t("grade.remedy"), wordRemedy(remedy)],
    i === 0 && improved !== null && [t("grade.improved"), number(improved, 2)],
  ].filter(Boolean));
  return pairs(rows.flat());
}

const PLACES = { "low end": "grade.low_end", middle: "grade.middle", "high end": "grade.high_end" };

/** A remedy in the language of the page; what the service says otherwise stays. */
function wordRemedy(remedy) {
  const [, axis, where] = remedy.match(/^add a line along (\w+) at (.+)$/) ?? [];
  if (axis) {
    const places = where.split(" and ").map((place) => place.match(/^the (low end|middle|high end) of (\w+)$/));
    if (places.every(Boolean)) {
      return t("grade.add_line", { axis, where: places.map(([, at, of]) => t(PLACES[at], { of })).join(t("grade.and")) });
    }
  }
  const [, from, to] = remedy.match(/^add the diagonal from (.+) to (.+)$/) ?? [];
  if (from) return t("grade.add_diagonal", { from, to });
  return h("span", { lang: "en" }, remedy);
}

/** A place for the grade of a job that has not moved yet; asked for once there is a plan. */
export function plannedGrade() {
  const element = h("div", { class: "planned-grade", hidden: true });
  let asked = null;

  async function ask(id, place_mm) {
    asked = id;
    let found = null;
    try {
      found = await api.grade(id, place_mm);
    } catch (error) {
      // Whoever discards the job meanwhile needs no grade.
      api.expectProblem(error);
    }
    if (asked === id) show(found);
  }

  function show(grade) {
    element.replaceChildren(...[gradeCard(grade)].filter(Boolean));
    element.hidden = !grade;
  }

  return {
    element,
    update(job, plan) {
      if (plan && isActive(job) && asked !== job.id) ask(job.id, plan.place?.tracker.position_mm ?? []);
    },
  };
}
