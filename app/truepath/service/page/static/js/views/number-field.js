/* A number to type or to step, with its unit; what is kept is the stored unit. */
import { h, mark } from "../dom.js";
import { number, plain, t, typed } from "../texts.js";
import { decimalsOf, shown, stored, unitOf } from "../units.js";

/** Make a field; `write(value)` changes it.
 *
 * id, kind: of the input, of the quantity; label, note, less, more: texts; none: where it is empty
 * get(), set(value): the stored value, null where it is left empty, NaN where it is nonsense
 * least, most: limits; next(value, direction): the value one step away
 */
export function numberField({ id, kind, label, note, less, more, none, get, set, least, most, next }) {
  const input = h("input", { id, inputmode: "decimal", autocomplete: "off", placeholder: none,
    "aria-describedby": `${id}-note ${id}-error` });
  const error = h("p", { class: "field-error", id: `${id}-error`, role: "status" });
  const limit = (value) => number(shown(value, kind), shown(value, kind) < 10 ? decimalsOf(kind) : 0);
  const limits = { least: limit(least), most: limit(most), unit: unitOf(kind) };

  function show() {
    const value = get();
    input.value = value === null ? "" : plain(shown(value, kind), decimalsOf(kind));
    check();
  }

  function check() {
    const good = within(get(), least, most);
    mark(input, "aria-invalid", good ? null : "true");
    error.textContent = good ? "" : t("plan.limits", limits);
  }

  function step(direction) {
    const wanted = next(Number.isFinite(get()) ? get() : null, direction);
    write(wanted === null ? null : Math.min(most, Math.max(least, wanted)));
  }

  function write(value) {
    set(value);
    show();
  }

  input.addEventListener("input", () => {
    set(inStored(input.value, kind));
    check();
  });
  show();
  const button = (name, sign, direction) =>
    h("button", { class: "button", "aria-label": name, onclick: () => step(direction) }, sign);
  const element = h("div", { class: "field" }, h("label", { for: id }, label),
    h("div", { class: "stepper" }, button(less, "−", -1), input, button(more, "+", 1),
      h("span", { class: "suffix" }, unitOf(kind))),
    h("p", { class: "field-note", id: `${id}-note` }, note), error);
  return { element, write };
}

/** Whether a value may be sent: inside its limits, or left empty where that is allowed. */
export const within = (value, least, most) => value === null || (value >= least && value <= most);

function inStored(text, kind) {
  const value = typed(text);
  return value === null ? null : stored(value, kind);
}
