/* What will move once the job is armed, as the service will command it. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { machineName, waitsForArming } from "../flow.js";
import { card, notice, pairs } from "../parts.js";
import { wordProblem } from "../problems.js";
import { duration, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";

/** A card that asks the service for each version of the job that waits; keeps `arming` of the store. */
export function armingCard(store, actions) {
  const content = h("div", { role: "status" }, h("p", { class: "empty" }, t("arming.waiting")));
  let asked = "";
  let closed = false;

  async function ask(job) {
    let found = null;
    let shown;
    try {
      found = await api.prepareArming(job);
      shown = pairs(rowsOf(found, nameOf(found)));
    } catch (error) {
      api.expectProblem(error);
      shown = refusal(error, job);
    }
    const now = store.get().job;
    if (closed || now?.id !== job.id || now.version !== job.version) return;
    store.set({ arming: found });
    content.replaceChildren(...[shown].flat());
  }

  const nameOf = ({ machine: machine_id, machine_name: name }) =>
    machineName({ ...store.get(), machine_id, machine: { name } });

  /** Who has the job under control is named; the others may take it over. */
  function refusal(error, job) {
    const { title, text, action } = wordProblem(error);
    const take = async () => {
      if (await actions.takeControl()) ask(store.get().job ?? job);
    };
    return [notice("held", title, text, action), error.code === "not-in-control"
      && h("button", { class: "button below", "data-needs": "operator", onclick: take }, t("control.take"))].filter(Boolean);
  }

  return {
    element: h("div", { "data-needs": "operator" }, card(t("arming.title"), content)),
    update(job) {
      if (!job || !waitsForArming(job)) return;
      const key = `${job.id}:${job.version}`;
      if (key === asked) return;
      asked = key;
      store.set({ arming: null });
      ask(job);
    },
    close() {
      closed = true;
      store.set({ arming: null });
    },
  };
}

function rowsOf({ targets = [], envelope = [], max_feed_mm_min: feed, duration_s, rows, grows }, machine) {
  return [
    [t("check.machine"), machine],
    ...targets.map((target) => [t("arming.target"), describeTarget(target)]),
    ...envelope.map(({ axis, unit, low, high }) => [t("arming.axis", { axis }), rangeOf(low, high, unit === "deg" ? "turn" : "length")]),
    [t("arming.feed"), quantity(feed, "feed")],
    [t("check.time"), `${duration(duration_s)} min`],
    [t("arming.rows"), number(rows)],
    grows && [t("arming.grows"), t("arming.grows_text")],
  ].filter(Boolean);
}

const rangeOf = (low, high, kind) =>
  t("arming.from_to", { low: figure(low, kind, 1), high: quantity(high, kind, 1) });

function describeTarget({ name, on, offset_mm: offset }) {
  const place = `X Y Z ${offset.map((v) => figure(v, "length", 1)).join(" / ")} ${unitOf("length")}`;
  return `${name ? `${name}, ` : ""}${t(on === "tool" ? "arming.on_tool" : "arming.on_workpiece")}: ${place}`;
}
