/* Boxes that no motion may touch: stated for plans, and for what is based on an earlier measurement. */
import { h, icon, mark, write } from "../dom.js";
import { areWhole, boxesOf, isEnd, isWholeAlong, keepBoxes, LINEAR, orderBoxes } from "../keep-out.js";
import { segments } from "../parts.js";
import { number, plain, t, typed } from "../texts.js";
import { decimalsOf, shown, stored, unitOf } from "../units.js";

const MOST = 100;
const ENDS = [["min_mm", "keepout.from"], ["max_mm", "keepout.to"]];
const KIND = "length";
const WAYS = ["kept", "added", "only"];

/** Whether the boxes of the earlier measurement hold (`kept`), those of this panel as well (`added`), or these alone (`only`). */
const based = { by: "kept" };

/** The card of what is based on a measurement: its boxes hold, unless somebody says that they are gone. */
export function keepOutChoice(machine_id, machine, changed) {
  const editor = boxEditor(changed);
  const note = h("p", { class: "quiet" });
  based.by = boxesOf(machine_id).length ? "added" : "kept";

  function show() {
    editor.element.hidden = based.by === "kept";
    write(note, t(`keepout.${based.by}_text`));
  }

  editor.show(machine_id, machine);
  show();
  return h("section", { class: "card stack", "data-card": "keep-out" }, h("h2", {}, t("keepout.title")), segments(t("keepout.title"), WAYS.map((by) => [by, t(`keepout.${by}`)]), based.by, (by) => {
    based.by = by;
    show();
    changed();
  }, true), note, editor.element);
}

/** What an order that is based on a measurement says of boxes: nothing where those of the measurement hold alone. */
export function basedOrder(machine_id) {
  const keep_out = orderBoxes(boxesOf(machine_id));
  if (based.by === "only") return { keep_out, keep_out_replaces: true };
  return based.by === "added" && keep_out.length ? { keep_out } : {};
}

/** Why such an order cannot be sent; empty where it can. */
export const refuseBased = (machine_id) => (based.by === "kept" ? "" : refuseBoxes(machine_id));

/** Why the boxes of a machine cannot be sent; empty where they can. */
export const refuseBoxes = (machine_id) => (areWhole(boxesOf(machine_id)) ? "" : t("keepout.refused"));

/** Fields of all boxes; `changed()` hears of each change, `show(machine_id, machine)` draws those of another machine. */
export function boxEditor(changed) {
  const list = h("div", { class: "stack" });
  const add = h("button", { class: "button", onclick: addBox }, t("keepout.add"));
  const element = h("div", { class: "stack" }, list, h("div", {}, add));
  let id;
  let travel = [];

  function keep(boxes) {
    keepBoxes(id, boxes);
    changed();
  }

  function addBox() {
    const none = [null, null, null];
    keep([...boxesOf(id), { name: "", min_mm: none, max_mm: none }]);
    draw();
    list.lastElementChild.querySelector("input").focus();
  }

  function remove(at) {
    keep(boxesOf(id).filter((_, i) => i !== at));
    draw();
    add.focus();
  }

  const change = (at, box) => keep(boxesOf(id).map((one, i) => (i === at ? box : one)));

  function draw() {
    const boxes = boxesOf(id);
    list.replaceChildren(...boxes.map((box, at) => boxFields(box, { at, travel, change: (next) => change(at, next), remove: () => remove(at) })));
    mark(add, "disabled", boxes.length >= MOST);
  }

  return {
    element,
    show(machine_id, machine) {
      if (id === machine_id) return;
      [id, travel] = [machine_id, LINEAR.map((name) => machine?.axes?.[name] ?? {})];
      mark(element, "hidden", !id);
      draw();
    },
  };
}

/** Name and ends of one box; what is typed goes to `change(box)` at once. */
function boxFields(first, { at, travel, change, remove }) {
  let box = first;
  const error = h("p", { class: "field-error", id: `box-${at}-error`, role: "status" });
  const name = h("input", { id: `box-${at}-name`, value: box.name, maxlength: 200, autocomplete: "off", placeholder: t("keepout.example"),
    oninput: () => put({ name: name.value }) });
  const rows = LINEAR.map((axis, i) => ENDS.map(([end, word]) => endInput(axis, i, end, word)));

  function endInput(axis, i, end, word) {
    const value = box[end][i];
    const input = h("input", { inputmode: "decimal", autocomplete: "off", "data-end": `${axis} ${end}`, "aria-describedby": error.id,
      "aria-label": `${axis}, ${t(word)} (${unitOf(KIND)})`, value: value === null ? "" : plain(shown(value, KIND), decimalsOf(KIND)),
      placeholder: isEnd(travel[i][end]) ? number(shown(travel[i][end], KIND), 0) : "" });
    input.addEventListener("input", () => {
      const wanted = typed(input.value);
      put({ [end]: box[end].map((old, k) => (k === i ? wanted !== null && stored(wanted, KIND) : old)).map((v) => (isEnd(v) ? v : null)) });
    });
    return input;
  }

  function put(part) {
    box = { ...box, ...part };
    check();
    change(box);
  }

  /** Fields that are still empty are missing, not wrong: only the sentence says so. */
  function check() {
    rows.forEach((pair, i) => pair.forEach((input) => mark(input, "aria-invalid", input.value && !isWholeAlong(box, i) ? "true" : null)));
    write(error, areWhole([box]) ? "" : t("keepout.incomplete"));
  }

  check();
  return h("fieldset", { class: "keep-out-box", "data-box": at }, h("legend", { class: "unseen" }, t("keepout.box", { number: number(at + 1) })),
    h("div", { class: "text-field" }, h("label", { for: name.id }, t("keepout.name")), name),
    h("div", { class: "box-ends" }, h("span"), ENDS.map(([, word]) => h("span", { class: "quiet", "aria-hidden": "true" }, `${t(word)} (${unitOf(KIND)})`)),
      rows.map((pair, i) => [h("b", { "aria-hidden": "true" }, LINEAR[i]), pair])), error,
    h("div", {}, h("button", { class: "button", onclick: remove }, icon("cross"), t("keepout.remove"))));
}
