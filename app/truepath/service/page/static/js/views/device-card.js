/* The drivers of a machine: tried, and chosen where they are not fixed in the settings of the service. */
import * as api from "../api.js";
import { h, write } from "../dom.js";
import { isActive, isMeasuring } from "../flow.js";
import { card, notice, pairs, problemNotice } from "../parts.js";
import { lineOf } from "../problems.js";
import { number, t } from "../texts.js";
import { quantity } from "../units.js";

const DEVICES = ["tracker", "motion", "thermometer"];
const USUAL = { tracker: "streaming", motion: "modbus", thermometer: "" };
/** Shown at once; what is rarely changed is folded away. */
const PLAIN = new Set(["host", "port", "serial_port", "unit", "baudrate"]);
const HIDDEN = "***";

/** The card; `update(state)` shows the machine that the page works with. */
export function deviceCard({ actions }) {
  const body = h("div", { class: "stack" });
  const element = card(t("devices.title"), body);
  const trial = trialField();
  let shown = null;
  element.dataset.card = "devices";

  async function load(id) {
    const [record, drivers] = await Promise.all([api.machineRecord(id), api.drivers()]);
    if (shown !== id) return;
    body.replaceChildren(trial.element, ...(record.origin === "catalogue" ? [form(record, drivers, save)] : fixed(record)));
  }

  async function save(id, devices) {
    await api.setDevices(id, devices);
    await actions.loadSystem();
    await load(id);
  }

  return {
    element,
    update({ machine_id, job }) {
      trial.update(machine_id, Boolean(job && isMeasuring(job) && isActive(job)));
      element.hidden = !machine_id;
      if (!machine_id || machine_id === shown) return;
      shown = machine_id;
      load(machine_id).catch(actions.refuse);
    },
  };
}

/** Connect and listen for a second: nothing moves. */
function trialField() {
  const said = h("div", { role: "status" });
  const button = h("button", { class: "button", "data-needs": "operator" }, t("devices.try"));
  let id = null;
  button.addEventListener("click", async () => {
    button.disabled = true;
    said.replaceChildren(h("p", { class: "quiet" }, t("devices.trying")));
    said.replaceChildren(await api.tryDevices(id).then(tried, refusal));
    button.disabled = false;
  });
  const element = h("div", { class: "stack" }, h("p", { class: "quiet" }, t("devices.try_text")), h("div", {}, button), said);
  return {
    element,
    update(machine_id, isHeld) {
      id = machine_id;
      if (isHeld !== element.hidden) element.hidden = isHeld;
    },
  };
}

function tried({ samples, usable, lost_samples: lost, distance_mm }) {
  const place = distance_mm === null ? t("devices.no_target") : t("devices.target_at", { distance: quantity(distance_mm, "distance", 1) });
  const text = t("devices.tried", { samples: number(samples), lost: number(lost), place });
  return usable > 0 && distance_mm !== null ? notice(null, t("devices.works"), text)
    : notice("held", t("devices.no_use"), text, t("devices.no_use_action"));
}

function refusal(error) {
  api.expectProblem(error);
  return problemNotice(error);
}

/** What the settings of the service have chosen. */
function fixed({ devices }) {
  const rows = DEVICES.filter((device) => devices[`${device}_driver`])
    .map((device) => [t(`devices.${device}`), devices[`${device}_driver`]]);
  return [rows.length > 0 && pairs(rows), h("p", { class: "quiet" }, t("devices.fixed"))].filter(Boolean);
}

function form(record, drivers, save) {
  if (["viewer", "operator", "metrologist"].includes(document.body.dataset.role)) {
    return h("p", { class: "quiet" }, t("devices.administrator_only"));
  }
  const parts = DEVICES.map((device) => devicePart(device, record.devices, drivers.filter((one) => one.device === device)));
  const error = h("p", { class: "field-error", role: "alert" });
  const button = h("button", { class: "button", type: "submit" }, t("devices.save"));
  const element = h("form", { class: "stack" }, parts.map((part) => part.element), error, h("div", {}, button));
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    write(error, "");
    try {
      await save(record.id, Object.assign({}, record.devices, ...parts.map((part) => part.read())));
    } catch (refused) {
      if (!(refused instanceof api.Problem) && !(refused instanceof RangeError)) throw refused;
      error.replaceChildren(...lineOf(refused));
    }
    button.disabled = false;
  });
  return element;
}

/** One device: its driver, and the options of that driver. */
function devicePart(device, given, drivers) {
  const wanted = given[`${device}_driver`] ?? USUAL[device];
  const options = h("div", { class: "stack" });
  const choice = h("select", { id: `driver-${device}`, onchange: () => show() }, device === "thermometer" && h("option", { value: "" }, t("devices.none")),
    drivers.map(({ name }) => h("option", { value: name, selected: name === wanted }, name)));
  let fields = [];

  function show() {
    const driver = drivers.find(({ name }) => name === choice.value);
    const kept = choice.value === wanted ? given[`${device}_options`] ?? {} : {};
    fields = (driver?.options ?? []).map((option) => optionField(device, option, kept[option.name]));
    const plain = fields.filter(({ isPlain }) => isPlain).map(({ element }) => element);
    const more = fields.filter(({ isPlain }) => !isPlain).map(({ element }) => element);
    options.replaceChildren(h("div", { class: "text-fields" }, plain),
      ...(more.length ? [h("details", { class: "map-table" }, h("summary", {}, t("devices.more")), h("div", { class: "text-fields" }, more))] : []));
  }

  show();
  return {
    element: h("div", { class: "stack device-part", "data-device": device },
      h("div", { class: "field" }, h("label", { for: choice.id }, t(`devices.${device}`)), choice), options),
    read: () => ({ [`${device}_driver`]: choice.value,
      [`${device}_options`]: Object.fromEntries(fields.map((field) => field.read()).filter(([, value]) => value !== undefined)) }),
  };
}

/** One option; what is left empty is left to the driver. */
function optionField(device, { name, type, is_required: isRequired, default: usual }, value) {
  const isSecret = value === HIDDEN;
  const id = `option-${device}-${name}`;
  const hint = isSecret ? t("devices.secret") : isRequired || usual === null ? "" : String(usual);
  const shown = value === undefined || isSecret ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
  const input = h("input", { id, value: shown, placeholder: hint, required: isRequired || isSecret, autocomplete: "off", autocapitalize: "none",
    spellcheck: "false", type: /password|secret|token/.test(name) ? "password" : "text" });
  return {
    isPlain: isRequired || isSecret || value !== undefined || PLAIN.has(name),
    element: h("div", { class: "text-field" }, h("label", { for: id }, name, isRequired && h("span", { class: "unit" }, t("devices.required"))), input),
    read: () => [name, parse(input.value.trim(), type, name)],
  };
}

/** A typed option as its type has it; undefined where nothing is typed. Throws RangeError. */
function parse(text, type, name) {
  if (text === "") return undefined;
  if (/\bbool\b/.test(type) && /^(true|false)$/.test(text)) return text === "true";
  if (/\bint\b/.test(type) && /^-?\d+$/.test(text)) return Number(text);
  if (/\bfloat\b/.test(type) && /^-?[\d.,]+(e-?\d+)?$/i.test(text)) return Number(text.replace(",", "."));
  if (!/Sequence|Mapping|list|dict/.test(type)) return text;
  try {
    return JSON.parse(text);
  } catch {
    throw new RangeError(t("devices.no_json", { name }));
  }
}
