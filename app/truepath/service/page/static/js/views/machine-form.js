/* The axes of a machine: typed, or taken from its machine.json; to add one or to describe one anew. */
import { Problem } from "../api.js";
import { h, write } from "../dom.js";
import { lineOf } from "../problems.js";
import { plain, t, typed } from "../texts.js";
import { shown, stored, unitOf } from "../units.js";

const LONGEST_BYTES = 1 << 20;
const ENDS = ["min", "max"];
const USUAL = {
  schema: "machine/1", name: "", kinematic_chain: "w-X-b-Y-Z-t",
  axes: Object.fromEntries(["X", "Y", "Z"].map((name) => [name, { type: "linear", min_mm: 0, max_mm: null }])),
};

/** Whether whoever works here may add machines and describe them. */
export const mayDescribe = () => !["viewer", "operator", "metrologist"].includes(document.body.dataset.role);

/** A form; `save(id, machineFile)` is called with what is typed, and refuses with a Problem.
 *
 * name: of the inputs; content: of the machine.json that is changed; asksId: for a machine that is added
 */
export function machineForm({ name, content = USUAL, asksId = false, label, save }) {
  const id = asksId && textField(`${name}-id`, t("machine.id"), "", { pattern: "[a-z0-9][a-z0-9\\-]{0,31}", required: true, autocapitalize: "none" });
  const fields = h("div", { class: "text-fields" });
  const error = h("p", { class: "field-error", role: "alert" });
  const button = h("button", { class: "button", type: "submit" }, label);
  const file = h("input", { type: "file", accept: ".json,application/json", id: `${name}-file` });
  let known = content;
  let axes = [];
  let altitude = null;
  let texts = {};

  function fill(of) {
    known = of;
    texts = { name: textField(`${name}-name`, t("connect.name"), of.name ?? "", { required: true }),
      kinematic_chain: textField(`${name}-chain`, t("connect.chain"), of.kinematic_chain ?? "", { required: true }) };
    axes = Object.entries(of.axes ?? {}).flatMap(([axis, travel]) => ENDS.map((end) => travelField(name, axis, travel, end)));
    altitude = textField(`${name}-altitude`, [t("machine.altitude"), h("span", { class: "unit" }, "m")],
      of.site?.altitude_m === undefined ? "" : plain(of.site.altitude_m, 1), { inputmode: "decimal" });
    fields.replaceChildren(...[...Object.values(texts), ...axes, altitude].map((field) => field.element));
  }

  function read() {
    const described = structuredClone(known);
    for (const [key, field] of Object.entries(texts)) described[key] = field.input.value.trim();
    for (const { axis, key, value } of axes) described.axes[axis][key] = value();
    const height = altitude.input.value.trim();
    const altitude_m = height ? typed(height) : undefined;
    if (altitude_m === null || Number.isNaN(altitude_m)) throw new RangeError(t("machine.no_altitude"));
    if (height || described.site) described.site = { ...described.site, altitude_m };
    return described;
  }

  file.addEventListener("change", async () => {
    write(error, "");
    try {
      fill(await readMachineFile(file.files[0]));
    } catch (wrong) {
      if (!(wrong instanceof RangeError)) throw wrong;
      write(error, wrong.message);
    }
    file.value = "";
  });
  fill(content);
  const element = h("form", { class: "stack", "data-form": name },
    h("div", { class: "field" }, h("label", { for: file.id }, t("machine.file")), file, h("p", { class: "field-note" }, t("machine.file_note"))),
    id && h("div", { class: "text-fields" }, id.element), fields, error, h("div", {}, button));
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    write(error, "");
    try {
      await save(id ? id.input.value.trim() : "", read());
    } catch (refused) {
      if (!(refused instanceof Problem) && !(refused instanceof RangeError)) throw refused;
      error.replaceChildren(...lineOf(refused));
    }
    button.disabled = false;
  });
  return element;
}

function textField(id, label, value, more = {}) {
  const input = h("input", { id, value, maxlength: 200, autocomplete: "off", spellcheck: "false", ...more });
  return { input, element: h("div", { class: "text-field" }, h("label", { for: id }, label), input) };
}

/** One end of an axis's travel, in the length unit of the page or in degrees. */
function travelField(name, axis, travel, end) {
  const isRotary = travel.type === "rotary";
  const key = `${end}_${isRotary ? "deg" : "mm"}`;
  const kept = travel[key];
  const text = typeof kept === "number" ? plain(isRotary ? kept : shown(kept, "travel"), 4) : "";
  const label = [t(`machine.axis_${end}`, { axis }), h("span", { class: "unit" }, isRotary ? "°" : unitOf("travel"))];
  const field = textField(`${name}-${axis}-${end}`, label, text, { inputmode: "decimal", required: true });
  return { ...field, axis, key, value() {
    if (field.input.value === text) return kept; // no digit is lost where nothing was typed
    const number = typed(field.input.value);
    if (number === null || !Number.isFinite(number)) throw new RangeError(t("machine.no_number", { axis }));
    return isRotary ? number : stored(number, "travel");
  } };
}

/** The object in a machine.json; what is wrong inside it the service says. Throws RangeError. */
async function readMachineFile(file) {
  const refused = (why) => new RangeError(t(why, { name: file.name }));
  if (file.size > LONGEST_BYTES) throw refused("machine.file_large");
  try {
    const content = JSON.parse(await file.text());
    if (typeof content?.axes === "object" && content.axes !== null) return content;
  } catch (error) {
    if (!(error instanceof SyntaxError)) throw error;
  }
  throw refused("machine.file_wrong");
}
