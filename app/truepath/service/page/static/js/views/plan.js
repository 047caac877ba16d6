/* Step 2: how to measure, and how well. */
import { h, mark, write } from "../dom.js";
import { addressOf, isActive, isConnected, machineName } from "../flow.js";
import { term } from "../glossary.js";
import { areWhole, boxesOf, orderBoxes } from "../keep-out.js";
import { modelInUse } from "../model-choice.js";
import { fold, head, segments } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { recall, retain } from "../preferences.js";
import { number, t } from "../texts.js";
import { quantity } from "../units.js";
import { temperatureCard } from "./conditions-card.js";
import { curveCard, shownPart } from "./curve-card.js";
import { boxEditor, refuseBoxes } from "./keep-out-card.js";
import { modelNotice } from "./model-card.js";
import { numberField, within } from "./number-field.js";
import { choosesPlace, placeCard, placeOrder, refusePlace, stationCount } from "./place-fields.js";

const FEED_MM_MIN = { usual: 6000, least: 100, most: 20000, step: 500 };
const TARGET_UM = { usual: 5, least: 0.1, most: 1000, steps: [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100] };
const MINUTES = { usual: 3, least: 0.5, most: 60, steps: [0.5, 1, 2, 3, 5, 8, 12, 20, 40, 60] };
const choices = recall("choices", {
  kind: "measure-otf", most_feed_mm_min: null, expanded_um: null, perpendicular_only: false,
  by: "time", minutes: null, reach_um: null, on_notice: "note", control_compensation: "any",
});

const isAdaptive = () => choices.kind === "measure-adaptive";

/** Whether the plan is for an uncertainty instead of a time. */
const isForTarget = () => choices.by === "target" && choices.reach_um !== null && !isAdaptive() && stationCount() === 1;

/** What counts of the choices: several stations share a time. */
const effective = () => ({ ...choices, by: isForTarget() ? "target" : "time" });

/** Whether the machine moves while it is measured: only then there is a feed to choose. */
const streams = () => choices.kind !== "measure-standstill";

/** The usual path is not planned: it knows no boxes, and no place of the tracker. */
const isUsualPath = () => choices.minutes === null && !isAdaptive() && !isForTarget();

/** Several stations are measured to their end. */
const mayEndEarly = () => isAdaptive() || stationCount() === 1;

/** Button that leads on. */
export function lead(state, { actions, go }) {
  const { job } = state;
  const back = { label: t("shell.back"), run: () => go("#/connect") };
  if (isActive(job)) {
    return { back, reason: t("plan.busy"),
      next: { key: "show", label: t("connect.show_job"), run: () => go(addressOf(job)) } };
  }
  const reason = refusal(state);
  return { back, reason,
    next: { key: "prepare", label: t("plan.next"), disabled: Boolean(reason),
      run: () => actions.prepare(...orders(state)) } };
}

const isFeedGood = () => !streams() || within(choices.most_feed_mm_min, FEED_MM_MIN.least, FEED_MM_MIN.most);

/** Whether a plan can be asked for with what is chosen, by who looks on. */
const mayBePlanned = ({ machine, machine_id }) => isConnected(machine) && !isAdaptive() && document.body.dataset.role !== "viewer"
  && isFeedGood() && !refuseBoxes(machine_id) && !refusePlace();

function refusal({ machine, machine_id, busy, planned }) {
  const { minutes, expanded_um } = choices;
  if (busy) return planned !== null ? t("plan.planning", { percent: number(100 * planned) }) : t("plan.preparing");
  if (!isConnected(machine)) return t("plan.not_connected");
  if (!isFeedGood()) return t("plan.feed_refused");
  if (!within(minutes, MINUTES.least, MINUTES.most)) return t("plan.minutes_refused");
  if (choosesPlace() && isUsualPath()) return t("place.minutes_missing");
  if (refuseBoxes(machine_id)) return refuseBoxes(machine_id);
  if (boxesOf(machine_id).length && isUsualPath()) return t("keepout.minutes_missing");
  if (!isAdaptive() && refusePlace()) return refusePlace();
  return !mayEndEarly() || within(expanded_um, TARGET_UM.least, TARGET_UM.most) ? "" : t("plan.target_refused");
}

/** What is sent: a job, and the plan it drives, or null for the usual path.
 *
 * Files and interface carry standard uncertainties, the page shows k = 2.
 */
function orders(state) {
  const { kind, most_feed_mm_min: most, expanded_um, perpendicular_only, minutes, on_notice, control_compensation: wish } = choices;
  const job = { kind, perpendicular_only,
    ...(wish === "any" ? {} : { control_compensation: wish }),
    ...(on_notice === "note" || !mayEndEarly() || (isAdaptive() && on_notice !== "pause") ? {} : { on_notice }),
    ...(expanded_um === null || !mayEndEarly() ? {} : { target_um: expanded_um / COVERAGE }) };
  const limited = streams() && most !== null;
  if (isAdaptive()) return [{ ...job, planning: { ...planOrder(state), ...(minutes === null ? {} : { minutes }) } }, null];
  const shown = shownPart(asked(state), effective());
  if (shown) return [{ ...job, ...shown }, null];
  if (isForTarget()) return [job, { ...planOrder(state), target_um: choices.reach_um / COVERAGE }];
  if (minutes === null) {
    return [limited ? { ...job, feed_mm_min: Math.min(most, FEED_MM_MIN.usual) } : job, null];
  }
  return [job, { ...planOrder(state), minutes }];
}

/** What is asked of a plan whatever its length. */
function planOrder({ machine, machine_id }) {
  const { most_feed_mm_min: most, perpendicular_only } = choices;
  const { workspace = {}, ...site } = isAdaptive() ? {} : placeOrder(machine);
  const boxes = orderBoxes(boxesOf(machine_id));
  const within = { ...workspace, ...(boxes.length ? { keep_out: boxes } : {}) };
  return { mode: streams() ? "otf" : "standstill", perpendicular_only,
    ...(streams() && most !== null ? { max_feed_mm_min: most } : {}),
    ...(Object.keys(within).length ? { workspace: within } : {}), ...site };
}

/** A plan of any length, and all else that it is computed from: the machine as it is, and the model in use. */
function asked(state) {
  const { name, kinematic_chain, axes, targets, tool_offset_mm, motion_limits, tracker_noise } = state.machine ?? {};
  return { order: planOrder(state), model: modelInUse(state.machine), machine_id: state.machine_id,
    file: [name, kinematic_chain, axes, targets, tool_offset_mm, motion_limits, tracker_noise] };
}

/** Show the choices. */
export function mount(root, { store, actions }) {
  const changed = () => {
    retain("choices", choices);
    store.set({});
  };
  const { feed, minutes, target } = fields(changed);
  const policy = question("on-notice", "on_notice", "notice", ["note", "pause", "check", "replan"], changed);
  let shownId;
  const changedWithin = () => {
    planFor(store.get().machine_id);
    changed();
  };

  /** What the usual path does not know is planned. */
  function planFor(machine_id) {
    const isAsked = choosesPlace() || boxesOf(machine_id).length > 0;
    if (isAsked && choices.minutes === null) minutes.write(MINUTES.usual);
  }

  const place = placeCard(changedWithin);
  const keepOut = boxEditor(changedWithin);
  const temperatures = temperatureCard(store);
  const method = fold("method", t("plan.how"), kinds(changed), perpendicular(changed));
  const details = fold("details", t("plan.details"), answered(store.get()), minutes.element, feed.element, target.element,
    question("control-compensation", "control_compensation", "compensation", ["any", "off", "on"], changed), policy);
  const curve = curveCard({
    asked: () => (mayBePlanned(store.get()) ? asked(store.get()) : null),
    foresee: actions.foresee,
    find: actions.findPlan,
    choice: effective,
    boxes: () => boxesOf(store.get().machine_id).filter((box) => areWhole([box])),
    beside: h("div", { class: "stack", "data-card": "keep-out" }, h("h3", {}, term("keep_out")), keepOut.element),
    pick(picked) {
      Object.assign(choices, picked);
      if (picked.minutes !== undefined) minutes.write(picked.minutes);
      changed();
    },
  });
  root.append(
    head(t("plan.title"), t("curve.text")), modelNotice(store.get().machine), curve.element,
    h("div", { class: "folds" }, temperatures.element, method.element, place.element, details.element, curve.more),
  );
  return {
    update(state) {
      temperatures.update(state);
      keepOut.show(state.machine_id, state.machine);
      if (shownId !== state.machine_id) {
        shownId = state.machine_id;
        planFor(shownId);
      }
      mark(curve.element, "data-adaptive", isAdaptive());
      curve.update(state);
      minutes.element.hidden = isForTarget();
      feed.element.hidden = !streams();
      target.element.hidden = !mayEndEarly();
      policy.hidden = !mayEndEarly();
      place.element.hidden = isAdaptive();
      write(method.value, t(`kind.${choices.kind}`));
    },
    close() {
      temperatures.close();
      curve.close();
    },
  };
}

/** Which devices have answered: the page may have gone on by itself. */
function answered(state) {
  const named = (device) => [device.maker, device.model, device.serial_number].filter(Boolean).join(" ");
  const { tracker, motion } = state.machine ?? {};
  return tracker && motion ? h("p", { class: "quiet", id: "answered" },
    t("plan.answered", { machine: machineName(state), tracker: named(tracker), control: named(motion) })) : "";
}

function kinds(changed) {
  const option = (kind) => h("button", { class: "choice", role: "radio",
    "aria-checked": String(choices.kind === kind), "data-kind": kind,
    onclick: () => choose(kind) },
  h("strong", {}, t(`kind.${kind}`)), h("span", {}, t(`plan.${kind}`)));
  const options = ["measure-otf", "measure-standstill", "measure-adaptive"].map(option);
  function choose(kind) {
    choices.kind = kind;
    for (const o of options) mark(o, "aria-checked", String(o.dataset.kind === kind));
    changed();
  }
  return h("div", { class: "stack", role: "radiogroup", "aria-label": t("plan.how") }, options);
}

/** Keep a choice and tell it. */
const keep = (name, changed) => (value) => {
  choices[name] = value;
  changed();
};

/** The next of some steps; `below` and `above` are beyond their ends. */
const stepIn = ({ usual, steps }, below, above) => (value, direction) => {
  if (value === null) return usual;
  return direction < 0 ? steps.findLast((one) => one < value - 1e-9) ?? below : steps.find((one) => one > value + 1e-9) ?? above;
};

/** Fields of feed, minutes and target; each may be left empty. */
function fields(changed) {
  const { usual, step } = FEED_MM_MIN;
  const field = (id, name, kind, limits, next, [less, more], note = {}) => numberField({
    id, kind, label: t(`plan.${id}`, { k: COVERAGE }), note: t(`plan.${id}_note`, note), less: t(`plan.${less}`), more: t(`plan.${more}`),
    none: t(`plan.${id}_none`), least: limits.least, most: limits.most, next, get: () => choices[name], set: keep(name, changed),
  });
  return {
    feed: field("feed", "most_feed_mm_min", "feed", FEED_MM_MIN,
      (feed, direction) => (feed === null ? usual : (Math.round(feed / step) + direction) * step), ["slower", "faster"], { usual: quantity(usual, "feed") }),
    minutes: field("minutes", "minutes", "minutes", MINUTES, stepIn(MINUTES, null, MINUTES.most), ["shorter", "longer"]),
    target: field("target", "expanded_um", "error", TARGET_UM, stepIn(TARGET_UM, TARGET_UM.least, null), ["finer", "coarser"]),
  };
}

/** A choice in words under its question: what the control's own compensation has to be, or what is done where something changes. */
const question = (id, name, key, options, changed) => h("div", { class: "field", id }, h("p", { class: "label" }, t(`plan.${key}`)),
  segments(t(`plan.${key}`), options.map((one) => [one, t(`plan.${key}_${one}`)]), choices[name], keep(name, changed), true),
  h("p", { class: "quiet" }, t(`plan.${key}_help`)));

function perpendicular(changed) {
  const box = h("button", { class: "choice is-box", role: "checkbox",
    "aria-checked": String(choices.perpendicular_only),
    onclick: () => {
      choices.perpendicular_only = !choices.perpendicular_only;
      mark(box, "aria-checked", String(choices.perpendicular_only));
      changed();
    } },
  h("strong", {}, t("plan.perpendicular")), h("span", {}, t("plan.perpendicular_note")));
  return box;
}
