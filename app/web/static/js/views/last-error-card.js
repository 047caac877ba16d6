/* What last went wrong between the service and the devices of a machine, with what to do. */
import { h } from "../dom.js";
import { notice } from "../parts.js";
import { wordProblem } from "../problems.js";
import { dateTime, t } from "../texts.js";

/** The card; it stays until the devices answer again or somebody takes it away. */
export function lastErrorCard(forget) {
  const body = h("div");
  const element = h("section", { class: "card", "data-card": "last-error", hidden: true },
    h("h2", {}, t("connect.last_error")), body,
    h("button", { class: "button below", type: "button", onclick: forget }, t("connect.forget_error")));
  let shown = null;
  return {
    element,
    update({ deviceError: error }) {
      if (error === shown) return;
      shown = error;
      element.hidden = !error;
      if (!error) return;
      const { title, text, action } = wordProblem(error.problem);
      body.replaceChildren(h("p", { class: "quiet" }, dateTime(error.at)), notice("held", title, text, action));
    },
  };
}
