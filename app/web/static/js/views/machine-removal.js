/* A machine that is driven no more: what stays of it is said, and the button is held. */
import { Problem } from "../api.js";
import { h, icon, write } from "../dom.js";
import { holdToConfirm } from "../hold.js";
import { lineOf } from "../problems.js";
import { t } from "../texts.js";

/** Card that removes a machine; `remove()` refuses with a Problem. */
export function removalCard({ id, name }, remove) {
  const error = h("p", { class: "field-error", role: "alert" });
  const button = h("button", { class: "button", type: "button", id: "machine-remove" },
    icon("cross"), t("machine.remove_hold", { name: name || id }));
  holdToConfirm(button, async () => {
    button.disabled = true;
    write(error, "");
    try {
      await remove();
    } catch (refused) {
      if (!(refused instanceof Problem)) throw refused;
      error.replaceChildren(...(refused.status === 412 ? [t("machine.remove_stale")] : lineOf(refused)));
    }
    button.disabled = false;
  });
  return h("details", { class: "card", "data-card": "remove" }, h("summary", {}, t("machine.remove")),
    h("div", { class: "stack" }, h("p", {}, t("machine.remove_text", { id })), error, h("div", {}, button)));
}
