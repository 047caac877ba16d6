/* What a verification says: pass, fail or cannot be said, with its numbers. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { term } from "../glossary.js";
import { isVerification, resultOf } from "../flow.js";
import { card, linkButton, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { colour } from "../plots/css-colour.js";
import { linear, pickLinear, travelOf } from "../plots/job-path.js";
import { coordinates, drawScene, edges } from "../plots/scene.js";
import { currentLanguage, dateTime, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { circlesCard } from "./circles-card.js";
import { verdictBand } from "./verdict-band.js";

const DOUBTFUL = 0.01; // chance below which no machine explains a measurement, as in the service
const LINES_ACROSS = "three at standstills"; // start of `components` where lines show two of the three
const LOOKS = 5; // newest verifications that are looked through
const SHAPES = { within: "check", agrees: "check", outside: "warning", disagrees: "warning", undecided: "info" };

const MARKS = {
  within: { symbol: "circle", sign: "●", tone: "accent", size: 6 }, undecided: { symbol: "circle-open", sign: "○", tone: "trace-y", size: 8 },
  outside: { symbol: "diamond", sign: "◆", tone: "fault", size: 11 }, measured: { symbol: "circle", sign: "●", tone: "accent", size: 6 },
};

export const isProof = (job) => isVerification(job) && job.state === "succeeded";

/** The newest verification of a job, or of what a discovery has made of its result; or null: { job, verification }. */
export async function findProof(id, jobs) {
  for (const job of jobs.filter(isProof).slice(0, LOOKS)) {
    const verification = await api.verification(job.id).catch((error) => {
      api.expectProblem(error);
      return null;
    });
    const held = verification?.asked?.result_id;
    if (held && [held, resultOf(held, jobs)].includes(id)) return { job, verification };
  }
  return null;
}

/** The decision in a word of this page: of the tolerance where there is one, else of the agreement. */
export function decisionOf({ conformity, agreement }) {
  return conformity.measured?.conformity ?? (agreement.consistent ? "agrees" : "disagrees");
}

/** The verdict, what is wrong with its measurement, its places and the numbers that it rests on, in `cards`; `close` ends the picture. */
export function proofCards({ job, verification }, machine) {
  const picture = drawPlaces(verification, machine);
  return { close: picture.close,
    cards: [verdict(job, verification), verdictBand(verification.run_verdict), picture.element, numbers(verification), circlesCard(verification)].filter(Boolean) };
}

/** The measured places in the volume: inside and outside the tolerance differ by colour and shape. */
function drawPlaces({ places }, machine) {
  const space = h("div", { class: "path-view", role: "img", "aria-label": t("verify.places") });
  const found = places.conformity ?? places.row.map(() => "measured");
  const key = Object.keys(MARKS).filter((kind) => found.includes(kind)).map((kind) =>
    h("li", {}, h("b", { class: `is-${kind}` }, MARKS[kind].sign), t(`verify.place_${kind}`, { count: number(found.filter((one) => one === kind).length) })));
  const columns = linear(Object.keys(machine?.axes ?? { X: 0, Y: 0, Z: 0 }));
  const at_mm = places.position.map((row) => pickLinear(row, columns));
  const travel = travelOf(machine, at_mm);
  const scene = drawScene(space, [{ type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false, line: { color: colour("line-strong"), width: 1.5 }, ...edges(travel) },
    ...Object.entries(MARKS).map(([kind, { symbol, tone, size }]) => {
      const of = places.row.map((_, i) => i).filter((i) => found[i] === kind);
      return { type: "scatter3d", mode: "markers", showlegend: false, marker: { symbol, size, color: colour(tone) }, ...coordinates(of.map((i) => at_mm[i])),
        hoverinfo: "text", hovertext: of.map((i) => quantity(Math.hypot(...places.measured_um[i]), "gap")) };
    })], travel);
  scene.then(() => (space.dataset.drawn = ""));
  return { element: card(t("verify.places"), space, h("ul", { class: "key places-key" }, key)), close: () => scene.then((drawn) => drawn.close()) };
}

function verdict(job, verification) {
  const { conformity: { measured }, places } = verification;
  const decision = decisionOf(verification);
  return h("section", { class: "card proof", "data-decision": decision, role: "status" },
    icon(SHAPES[decision]),
    h("div", {}, h("h2", {}, t(`verify.is_${decision}`)), h("p", {}, measured ? reason(measured, places) : t("verify.no_tolerance"), " ", term("decision")), h("p", {}, agreement(verification)), scaleCause(verification),
      h("p", { class: "quiet" }, t("verify.when", { when: dateTime(job.ended ?? job.created) }))),
    linkButton(api.links.verificationReport(job.id), "report", t("result.report"), { target: "_blank", rel: "noopener" }));
}

/** The place that decides, against the tolerance. */
const reason = (one, { row }) => t("verify.worst", { count: number(row.length), length: quantity(one.length_um, "gap"),
  u: quantity(one.expanded_uncertainty_um, "gap"), k: number(one.coverage_factor, 1), tolerance: quantity(one.tolerance_um, "gap") });

function agreement({ agreement: { consistent, chance, share_within_expanded: share, chance_of_any_machine: other }, map_scale: scale }) {
  const values = { chance: number(100 * chance, 1), share: number(100 * share), k: COVERAGE };
  if (consistent) return t("verify.consistent", values);
  if (other >= DOUBTFUL) return t("verify.changed", values);
  return t(scale?.cause ? "verify.other_compensation" : "verify.no_machine", values);
}

/** Where the control's compensation is not what it is taken for; null where it is. */
function scaleCause({ map_scale: scale }) {
  return scale?.cause ? h("p", { class: "scale-cause" }, h("strong", {}, t(`verify.scale_${scale.cause}`, { value: number(scale.value, 2) }))) : null;
}

const ROWS = ["measured", "predicted", "deviation"];
const SIZES = ["mean", "p95", "largest"];

function numbers(verification) {
  const rows = ROWS.map((name) => h("tr", {}, h("th", { scope: "row" }, t(`verify.${name}`)),
    SIZES.map((size) => h("td", { class: "right" }, sized(verification.volumetric_error_um[name], size)))));
  const said = currentLanguage() === "en" ? verification.statements : wordStatements(verification);
  return card(t("verify.numbers"), tableFrame(t("verify.numbers"), h("table", { class: "proof-table" },
    h("thead", {}, h("tr", {}, h("th", {}, t("verify.error_of")), SIZES.map((size) => h("th", { class: "right" }, t(`verify.${size}`))))),
    h("tbody", {}, rows))), h("p", { class: "quiet" }, t("verify.numbers_note", { k: COVERAGE })),
    said.length > 0 && h("ul", { class: "lines" }, said.map((text) => h("li", {}, text))));
}

/** What is said nowhere else, in the language of the page: the statements of the service are English. */
function wordStatements({ components, unseen_directions: unseen, axes_at_rest: resting, conformity: { deviation }, places, runs = [] }) {
  return [
    deviation && t("verify.as_prediction", { decision: t(`verify.is_${deviation.conformity}`), worst: reason(deviation, places) }),
    components?.startsWith(LINES_ACROSS) && t("verify.across"),
    unseen?.length && t("verify.unseen", { axes: unseen.join(t("grade.and")) }),
    resting?.length && t("verify.resting", { axes: resting.join(", ") }),
    ...new Set(runs.filter(({ environment }) => environment).map(({ environment, length_scale_ppm: ppm }) => t("verify.lengths", { k: COVERAGE, ppm: number(COVERAGE * ppm, 2), ranges: t(`verify.ranges_${environment.refraction.by}`) }))),
  ].filter(Boolean);
}

const sized = (statistics, size) =>
  `${quantity(statistics[size], "gap")} ± ${quantity(COVERAGE * statistics[`${size}_uncertainty`], "gap")}`;
