/* What has to be so before the machine moves, as the service holds it, asked once a second. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { card } from "../parts.js";
import { known, t } from "../texts.js";

const ASK_MS = 1000;
const SHAPES = { true: "check", false: "warning", unknown: "info" };

/** The first condition that keeps the machine from being started; null where none does. */
export const obstacle = (conditions) =>
  conditions?.find(({ level, is_required }) => is_required && level === "false") ?? null;

/** A condition in words: what is wrong and what to do. */
export const wordsOf = ({ reason, message }) => known(`condition.reason.${reason}`, message);

/** Card with all conditions; `close` ends the asking. */
export function conditionsCard(store) {
  const list = h("ul", { class: "conditions" });
  let closed = false;
  let shown = "";

  async function ask() {
    if (closed) return;
    const conditions = await api.conditions().catch(() => null);
    if (closed) return;
    store.set({ conditions });
    setTimeout(ask, ASK_MS);
  }

  ask();
  return {
    element: card(t("condition.title"), list),
    update(conditions) {
      const key = JSON.stringify(conditions);
      if (key === shown) return;
      shown = key;
      list.replaceChildren(...(conditions ? [...conditions].sort(byUrgency).map(row)
        : [h("li", { class: "empty" }, t("condition.none"))]));
    },
    close() {
      closed = true;
      store.set({ conditions: null });
    },
  };
}

/** `told` is wrong and stands in nobody's way. */
const stateOf = ({ level, is_required }) => (level === "false" && !is_required ? "told" : level);

const ORDER = ["false", "told", "unknown", "true"];

/** What stands in the way first; what is as it should be last. */
const byUrgency = (a, b) => ORDER.indexOf(stateOf(a)) - ORDER.indexOf(stateOf(b));

function row(condition) {
  const { type, level, is_required, since } = condition;
  const state = stateOf(condition);
  const at = new Date(since).toLocaleTimeString(document.documentElement.lang);
  return h("li", { "data-level": state, "data-type": type },
    icon(SHAPES[level]),
    h("b", {}, known(`condition.${type}`, type.replaceAll("-", " "))),
    h("span", { class: "condition-since" }, t("condition.since", { at })),
    level === "true" ? null : h("p", {}, level === "unknown" ? t("condition.unknown") : wordsOf(condition)),
    state === "told" && h("p", { class: "quiet" }, t("condition.no_obstacle")));
}
