/* Step 2: how to measure, and how well. */
import { h, mark } from "../dom.js";
import { addressOf, isActive, isConnected, machineName } from "../flow.js";
import { areWhole, boxesOf, orderBoxes } from "../keep-out.js";
import { modelInUse } from "../model-choice.js";
import { head, segments } from "../parts.js";
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
  const feed = feedField(changed);
  const minutes = minutesField(changed);
  const target = targetField(changed);
  const policy = noticePolicy(changed);
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
  temperatures.element.classList.add("below");
  const curve = curveCard({
    asked: () => (mayBePlanned(store.get()) ? asked(store.get()) : null),
    foresee: actions.foresee,
    find: actions.findPlan,
    choice: effective,
    boxes: () => boxesOf(store.get().machine_id).filter((box) => areWhole([box])),
    beside: h("div", { class: "stack", "data-card": "keep-out" }, h("h3", {}, t("keepout.title")), keepOut.element),
    pick(picked) {
      Object.assign(choices, picked);
      if (picked.minutes !== undefined) minutes.write(picked.minutes);
      changed();
    },
  });
  root.append(
    head(t("plan.title"), t("curve.text")), modelNotice(store.get().machine), curve.element, temperatures.element, answered(store.get()),
    h("div", { class: "columns" },
      h("div", { class: "stack" },
        h("section", { class: "card stack" }, h("h2", {}, t("plan.how")), kinds(changed), perpendicular(changed)), place),
      h("section", { class: "card stack" }, h("h2", {}, t("plan.details")), minutes.element, feed.element,
        target.element, compensationWish(changed), policy)),
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
      place.hidden = isAdaptive();
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
  return tracker && motion ? h("p", { class: "quiet below", id: "answered" },
    t("plan.answered", { machine: machineName(state), tracker: named(tracker), control: named(motion) })) : "";
}

function kinds(changed) {
  const option = (kind) => h("button", { class: "choice", type: "button", role: "radio",
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

function feedField(changed) {
  const { usual, least, most, step } = FEED_MM_MIN;
  return numberField({
    id: "feed", kind: "feed", label: t("plan.feed"), note: t("plan.feed_note", { usual: quantity(usual, "feed") }),
    less: t("plan.slower"), more: t("plan.faster"), none: t("plan.feed_none"), least, most,
    get: () => choices.most_feed_mm_min, set: keep("most_feed_mm_min", changed),
    next: (feed, direction) => (feed === null ? usual : (Math.round(feed / step) + direction) * step),
  });
}

function minutesField(changed) {
  const { usual, least, most, steps } = MINUTES;
  const shorter = (minutes) => steps.findLast((s) => s < minutes - 1e-9) ?? null;
  const longer = (minutes) => steps.find((s) => s > minutes + 1e-9) ?? most;
  return numberField({
    id: "minutes", kind: "minutes", label: t("plan.minutes"), note: t("plan.minutes_note"),
    less: t("plan.shorter"), more: t("plan.longer"), none: t("plan.minutes_none"), least, most,
    get: () => choices.minutes, set: keep("minutes", changed),
    next: (minutes, direction) => {
      if (minutes === null) return usual;
      return direction < 0 ? shorter(minutes) : longer(minutes);
    },
  });
}

function targetField(changed) {
  const { usual, least, most, steps } = TARGET_UM;
  const finer = (target) => steps.findLast((s) => s < target - 1e-9) ?? least;
  const coarser = (target) => steps.find((s) => s > target + 1e-9) ?? null;
  return numberField({
    id: "target", kind: "error", label: t("plan.target", { k: COVERAGE }), note: t("plan.target_note"),
    less: t("plan.finer"), more: t("plan.coarser"), none: t("plan.target_none"), least, most,
    get: () => choices.expanded_um, set: keep("expanded_um", changed),
    next: (target, direction) => {
      if (target === null) return usual;
      return direction < 0 ? finer(target) : coarser(target);
    },
  });
}

/** What the control's own error compensation has to be while it is measured; arming is refused while it is not. */
function compensationWish(changed) {
  const options = ["any", "off", "on"].map((one) => [one, t(`plan.compensation_${one}`)]);
  return h("div", { class: "field", id: "control-compensation" }, h("p", { class: "label" }, t("plan.compensation")),
    segments(t("plan.compensation"), options, choices.control_compensation, keep("control_compensation", changed), true),
    h("p", { class: "quiet" }, t("plan.compensation_help")));
}

/** What is done where something changes while it is measured. */
function noticePolicy(changed) {
  const options = ["note", "pause", "check", "replan"].map((one) => [one, t(`plan.notice_${one}`)]);
  return h("div", { class: "field", id: "on-notice" }, h("p", { class: "label" }, t("plan.notice")),
    segments(t("plan.notice"), options, choices.on_notice, keep("on_notice", changed), true),
    h("p", { class: "quiet" }, t("plan.notice_help")));
}

function perpendicular(changed) {
  const box = h("button", { class: "choice is-box", type: "button", role: "checkbox",
    "aria-checked": String(choices.perpendicular_only),
    onclick: () => {
      choices.perpendicular_only = !choices.perpendicular_only;
      mark(box, "aria-checked", String(choices.perpendicular_only));
      changed();
    } },
  h("strong", {}, t("plan.perpendicular")), h("span", {}, t("plan.perpendicular_note")));
  return box;
}
