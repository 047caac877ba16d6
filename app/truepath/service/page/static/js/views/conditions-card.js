/* What has to be so before the machine moves, as the service holds it: told by events, asked every few seconds. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { card, markStale } from "../parts.js";
import { clock, known, number, t } from "../texts.js";

const ASK_MS = 1000;
const SHORT_S = 60; // a change in less than this says nothing
const SHAPES = { true: "check", false: "warning", unknown: "info" };
const TEMPERATURES = "temperature-steady";

/** The first condition that keeps the machine from being started; null where none does. */
export const obstacle = (conditions) =>
  conditions?.find(({ level, is_required }) => is_required && level === "false") ?? null;

/** A condition in words: what is wrong and what to do. */
export const wordsOf = ({ reason, message }) => known(`condition.reason.${reason}`, message);

/** The conditions with one of them as an event tells it. */
export const replaceCondition = (conditions, told) =>
  conditions.map((one) => (one.type === told.type ? { ...one, ...told } : one));

/** Keep the conditions of the store fresh; returns what ends that. */
export function followConditions(store) {
  let closed = false;

  async function ask() {
    if (closed) return;
    const conditions = await api.conditions().catch(() => null);
    if (closed) return;
    store.set({ conditions });
    setTimeout(ask, ASK_MS);
  }

  ask();
  return () => {
    closed = true;
    store.set({ conditions: null });
  };
}

/** Card with all conditions; `close` ends the asking. */
export function conditionsCard(store) {
  const none = h("li", { class: "empty" }, t("condition.none"));
  return listCard(store, t("condition.title"), (conditions) => (conditions ? [...conditions].sort(byUrgency).map(row) : [none]));
}

/** The temperatures before a Run, with the name of each thermometer; hidden where none shows any. */
export function temperatureCard(store) {
  return listCard(store, t("condition.temperatures"), (conditions) =>
    (conditions ?? []).filter(({ type, temperatures }) => type === TEMPERATURES && temperatures?.length).map(row));
}

function listCard(store, title, rowsOf) {
  const list = h("ul", { class: "conditions" });
  const element = card(title, list);
  element.hidden = true;
  let shown = null;
  return {
    element,
    update({ conditions, link }) {
      markStale(element, link.stale ? link.age_s : null);
      const key = JSON.stringify(conditions);
      if (key === shown) return;
      shown = key;
      list.replaceChildren(...rowsOf(conditions));
      element.hidden = !list.children.length;
    },
    close: followConditions(store),
  };
}

/** `told` is wrong and stands in nobody's way. */
const stateOf = ({ level, is_required }) => (level === "false" && !is_required ? "told" : level);

/** Types of which all is shown: the list is written anew each time that one of them changes. */
const opened = new Set();

const ORDER = ["false", "told", "unknown", "true"];

/** What stands in the way first; what is as it should be last. */
const byUrgency = (a, b) => ORDER.indexOf(stateOf(a)) - ORDER.indexOf(stateOf(b));

function row(condition) {
  const { type, level, since, temperatures } = condition;
  const state = stateOf(condition);
  const line = [icon(SHAPES[level]), h("b", {}, nameOf(type, state))];
  const more = [explain(condition), (temperatures ?? []).map(temperature).join("; "), state === "told" && t("condition.no_obstacle"),
    state !== "true" && t("condition.since", { at: clock(new Date(since)) })].filter(Boolean);
  const details = () => h("details", { open: opened.has(type), ontoggle: ({ target }) => (target.open ? opened.add(type) : opened.delete(type)) },
    h("summary", {}, line), more.map((text) => h("p", {}, text)));
  return h("li", { "data-level": state, "data-type": type }, more.length ? details() : line);
}

/** A condition by its name, the state that is required; a word before it where that is missing or unknown. */
function nameOf(type, state) {
  const name = known(`condition.${type}`, type.replaceAll("-", " "));
  return state === "true" ? name : t(`condition.is_${state}`, { name });
}

/** What is wrong and what to do; of what is well, a state that is worth a word. */
function explain(condition) {
  const { type, level, reason, temperatures } = condition;
  if (level === "false") return wordsOf(condition);
  if (level === "true") return known(`condition.reason.${reason}`, "");
  if (type === TEMPERATURES && temperatures?.length) return t("condition.warming");
  return known(`condition.reason.${reason}`, t("condition.unknown"));
}

function temperature({ channel, value_degC: value, change_degC: change, over_s: over }) {
  const name = channel.replace(/_degC$/, "");
  const of = known(`sensor.${name}`, name);
  if (over < SHORT_S) return `${of} ${number(value, 1)} °C`;
  return t("condition.temperature", { of, value: number(value, 1),
    change: number(change, 1), minutes: number(over / 60, 0) });
}
