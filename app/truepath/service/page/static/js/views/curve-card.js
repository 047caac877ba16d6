/* What time buys: the curve of a long plan, the part of it that the handle chooses, and the set-up in space. */
import { h, mark, write } from "../dom.js";
import { term } from "../glossary.js";
import { fold, notice, segments, tile } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { linear, offsetOf, pickLinear } from "../plots/job-path.js";
import { drawPlanCurve } from "../plots/plan-curve.js";
import { drawPlanSpace } from "../plots/plan-space.js";
import { recall, retain } from "../preferences.js";
import { sayUnobservable } from "../statements.js";
import { nameOf } from "../tables.js";
import { duration, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { adviceCard, settleCard } from "./advice-card.js";
import { travelOf } from "./place-fields.js";

const LONGEST_MIN = ["3", "6", "12"];

/** What has been computed, kept while the operator looks elsewhere. */
const ahead = recall("ahead", { longest: "3", minutes: 0, key: "", plan_id: null, at: 0 });
ahead.plan = null;
const REST_MS = 500; // until choices that change count

/** The beginning of the computed plan that is driven: what the card shows; null where it is none of these choices.
 *
 * asked: a plan whatever its length, with all that it is computed from
 */
export function shownPart(asked, choice) {
  const at = ahead.plan && ahead.key === keyOf(asked) ? placeOf(choice) : null;
  return at === null ? null : { plan_id: ahead.plan.id, plan_rows: rowAt(at) };
}

/** By which choices a curve counts: all but the time. */
const keyOf = (asked) => JSON.stringify(asked);

/** Where on the curve a choice is; null where the curve does not go there. */
function placeOf({ by, minutes, reach_um }) {
  const { points } = ahead.plan.curve;
  const is = (at) => (at < 0 ? null : at);
  if (by === "target" && reach_um !== null) return is(points.findIndex((p) => p.expanded_volumetric_uncertainty_um <= reach_um));
  if (minutes === minutesOf(points[ahead.at])) return ahead.at;
  return minutes === null || minutes > ahead.minutes ? null : is(points.findLastIndex((p) => p.time_s <= 60 * minutes + 0.5));
}

const minutesOf = (point) => Math.max(0.5, Math.ceil(point.time_s / 6) / 10);

/** The card; `update(state)` hears of the machine, `close` ends it.
 *
 * asked(): what a plan is asked whatever its length, with all that it is computed from, null where none can be asked for;
 * foresee(request, tell): has one made; find(id): one that was made
 * choice(): {kind, by, minutes, reach_um}, of what is chosen; pick({by, minutes, reach_um}): tells what was chosen
 * boxes(): kept clear, as far as they are whole; beside: what is shown beside the picture
 */
export function curveCard({ asked, foresee, find, choice, pick, boxes, beside }) {
  let machine = null;
  let wanted = ahead.plan_id ? `${ahead.minutes} ${ahead.key}` : "";
  let due = null;
  let closed = false;
  let curve = null;
  let drawn = null; // the plan whose curve is there
  let pictured; // the plan that is drawn in space, null for the travel alone
  let picture = Promise.resolve(null);
  let kept = "";
  const label = (text) => h("span", { class: "label" }, text);
  const [waiting, weak] = ["quiet", "curve-weak"].map((name) => h("p", { class: name, role: "status" }));
  const [chart, below] = ["curve-chart", "curve-more"].map((name) => h("div", { class: name }));
  const space = h("div", { class: "curve-space", role: "img", "aria-label": t("curve.space") });
  const stale = h("div", { hidden: true }, notice("held", t("curve.stale"), t("curve.stale_text")));
  const names = { minutes: t("curve.minutes"), lines: t("curve.lines"), uncertainty: term("uncertainty", t("result.u", { k: COVERAGE })), grade: term("grade", t("curve.grade")) };
  const tiles = Object.fromEntries(Object.entries(names).map(([name, text]) => [name, tile(text)]));
  const key = [["chosen", t("curve.chosen")], ["rest", t("curve.rest")], ["sight", t("curve.sight")], ["tool", t("curve.tool")]];
  const element = h("section", { class: "card stack", "data-card": "curve", "aria-label": t("curve.title") },
    h("div", { class: "curve-ask" }, h("h2", {}, t("curve.title")), label(t("curve.longest")),
      segments(t("curve.longest"), LONGEST_MIN.map((m) => [m, `${number(m)} min`]), ahead.longest, (value) => {
        ahead.longest = value;
        show();
      }, true), waiting,
      h("div", { class: "curve-by" }, label(t("curve.by")),
        segments(t("curve.by"), [["time", t("curve.by_time")], ["target", t("curve.by_target")]], choice().by, (value) => {
          pick({ by: value });
          if (drawn) put(ahead.at);
        }, true))), stale,
    h("div", { class: "curve-pictures" }, chart,
      space, h("ul", { class: "key curve-key" }, key.map(([name, text]) => h("li", { class: `is-${name}` }, h("i"), text))),
      h("div", { class: "curve-beside" }, h("dl", { class: "tiles curve-tiles" }, Object.values(tiles).map((one) => one.element)), beside)), weak);

  /** After a reload the plan is still where it was made. */
  async function findAgain() {
    const plan = await find(ahead.plan_id);
    if (ahead.plan || closed) return;
    if (plan) ahead.plan = plan;
    else wanted = "";
    show();
  }

  /** Have the curve computed that belongs to the choices, once these rest; another choice makes it void. */
  function askSoon() {
    const all = asked();
    const minutes = Math.max(Number(ahead.longest), choice().minutes ?? 0);
    const own = `${minutes} ${keyOf(all)}`;
    if (!all || own === wanted) return;
    wanted = own;
    clearTimeout(due);
    due = setTimeout(ask, REST_MS, own, all, minutes);
  }

  async function ask(own, all, minutes) {
    const tell = (share) => own === wanted && write(waiting, t("plan.planning", { percent: number(100 * (share ?? 0)) }));
    tell(0);
    const plan = await foresee({ ...all.order, minutes }, tell);
    if (own !== wanted || closed) return;
    write(waiting, "");
    if (!plan) return;
    Object.assign(ahead, { key: keyOf(all), minutes, plan, plan_id: plan.id, at: plan.curve.points.length - 1 });
    ahead.at = placeOf(choice()) ?? ahead.at;
    const { reach_um, ...time } = choiceAt(ahead.at);
    pick({ reach_um, ...(choice().minutes === null ? time : {}) }); // what is shown is chosen, but where a time was
    show();
  }

  function show() {
    askSoon();
    if (!machine?.axes || closed) return;
    const plan = choice().kind === "measure-adaptive" ? null : ahead.plan;
    if (plan !== pictured) drawSpace(plan);
    const now = JSON.stringify(boxes());
    if (now !== kept) picture.then((there) => there?.keepOut(boxes()));
    kept = now;
    if (!ahead.plan) return;
    if (drawn !== ahead.plan) drawCurve();
    const isDriven = asked() !== null && shownPart(asked(), choice()) !== null;
    if (isDriven && placeOf(choice()) !== ahead.at) put(placeOf(choice()), false);
    mark(stale, "hidden", isDriven);
  }

  /** Draw a plan in space once what was drawn before is gone. */
  function drawSpace(plan) {
    pictured = plan;
    picture = picture.then(async (before) => {
      before?.close();
      if (closed) return null;
      const made = await drawPlanSpace(space, place(plan, machine, boxes()), plan && rowAt(ahead.at));
      space.dataset.drawn = plan?.id ?? "";
      return made;
    });
  }

  function drawCurve() {
    curve?.close();
    drawn = ahead.plan;
    curve = drawPlanCurve(chart, drawn.curve.points, put);
    below.replaceChildren(...more(drawn, drawn.curve.unobservable));
    put(ahead.at, false);
  }

  /** Let everything follow the handle. */
  function put(at, isChosen = true) {
    ahead.at = at;
    const { plan, ...kept } = ahead;
    retain("ahead", kept);
    const point = drawn.curve.points[at];
    const u = quantity(point.expanded_volumetric_uncertainty_um, "gap");
    const minutes = `${duration(point.time_s)} min`;
    write(tiles.minutes.number, minutes);
    write(tiles.lines.number, number(point.row - (drawn.commanded.kind === "path" ? 1 : 0)));
    write(tiles.uncertainty.number, u);
    write(tiles.grade.number, point.grade ? `${number(point.grade.number, 2)}: ${t(`grade.${point.grade.verdict}`)}` : "–");
    write(weak, point.weakest.length ? t("curve.weak", { errors: point.weakest.map(named).join("; ") }) : "");
    curve.update(at, choice().by === "target" ? point.expanded_volumetric_uncertainty_um : null, t("curve.spoken", { minutes, u }));
    picture.then((there) => pictured && there?.choose(point.row));
    if (isChosen) pick(choiceAt(at));
  }

  if (ahead.plan_id && !ahead.plan) findAgain();
  return {
    element, more: below,
    update(state) {
      machine = state.machine;
      show();
    },
    close() {
      closed = true;
      clearTimeout(due);
      curve?.close();
      picture.then((there) => there?.close());
    },
  };
}

const rowAt = (at) => ahead.plan.curve.points[at].row;

/** What a place on the curve means. */
function choiceAt(at) {
  const point = ahead.plan.curve.points[at];
  return { minutes: minutesOf(point), reach_um: point.expanded_volumetric_uncertainty_um };
}

const named = ({ error, at_tool_um }) => t("curve.weak_one", { error, name: nameOf(error), u: quantity(COVERAGE * at_tool_um, "gap") });

/** Stations and tools in words, where the plan has something to say of them. */
function more(plan, unobservable) {
  const { tracker, stations, at_stations, predicted } = plan.document ?? {};
  const advice = stations ? adviceCard({ place: { tracker, stations, at_stations } }) : null;
  const blind = unobservable.length
    ? fold("blind", t("curve.blind", { count: number(unobservable.length) }), h("ul", { class: "lines" }, unobservable.map((text) => h("li", {}, sayUnobservable(text))))).element : null;
  return [advice, settleCard(predicted), blind].filter(Boolean);
}

/** Rows with where the tracker stands for each, the travel, and the reflector on the tool. */
function place(plan, machine, boxes) {
  const { axes, position, stations } = plan?.commanded ?? { stations: [] };
  const columns = linear(axes ?? []);
  const parts = stations ?? [{ position, position_mm: plan.curve.tracker_mm }];
  const rows = parts.flatMap((part) => part.position.map((row) => ({ at_mm: pickLinear(row, columns), tracker_mm: part.position_mm })));
  return { rows, offset_mm: offsetOf(machine), boxes, travel: travelOf(machine) };
}
