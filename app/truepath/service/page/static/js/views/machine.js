/* The step Machine: which machines there are, how each stands, and who it is. */
import * as api from "../api.js";
import { Problem } from "../api.js";
import { h, icon, mark, write } from "../dom.js";
import { addressOf, isActive, isConnected, isMeasuring } from "../flow.js";
import { holdToConfirm } from "../hold.js";
import { card, head, notice, wordOf } from "../parts.js";
import { lineOf } from "../problems.js";
import { dateTime, number, plain, t, typed } from "../texts.js";
import { decimalsOf, quantity, shown, stored, unitOf } from "../units.js";
import { deviceCard } from "./device-card.js";
import { wordEntry } from "./history-card.js";
import { machineForm, mayDescribe } from "./machine-form.js";

const DAY_MS = 86400e3;
const HOUR_MS = 3600e3;
const IDENTITY = ["name", "maker", "model", "serial_number", "control", "customer", "place"];
const SHAPES = { alarm: "warning", calm: "check", unknown: "info" };

/** Button that leads on. */
export function lead({ job, busy }, { go }) {
  if (isActive(job)) return { next: { key: "show", label: t("connect.show_job"), run: () => go(addressOf(job)) } };
  return { next: { key: "devices", label: t("machine.next"), disabled: Boolean(busy), run: () => go("#/connect") } };
}

/** Show the machines. */
export function mount(root, { store, actions }) {
  const list = h("div", { class: "machine-list" });
  const identity = h("div", { class: "stack" });
  const adding = h("div");
  let entries = [];
  const removed = h("div", { role: "status" });
  root.append(head(t("machine.title"), t("machine.text")), removed, h("div", { class: "stack" }, list, identity, adding));

  async function load(shown = null) {
    entries = await api.machines();
    if (mayDescribe()) adding.replaceChildren(addCard(add));
    if (!entries.length) {
      list.replaceChildren(notice(null, t("connect.no_machine")));
      identity.replaceChildren();
      return;
    }
    const known = await Promise.all(entries.map(async (entry) => ({ entry, ...await standingOf(entry.id) })));
    const { machine_id: chosen } = store.get();
    list.replaceChildren(...known.map((one) => machineCard(one, { chosen, several: entries.length > 1, choose })));
    showStates(store.get());
    await edit(entries.find(({ id }) => id === (shown ?? chosen)) ?? entries[0]);
  }

  /** The states alone: what is being typed below stays. */
  function showStates(state) {
    for (const entry of entries) {
      const place = list.querySelector(`[data-machine="${CSS.escape(entry.id)}"] .machine-state`);
      if (place) write(place, stateOf(entry, state));
    }
  }

  async function add(id, machineFile) {
    await api.addMachine(id, machineFile);
    await Promise.all([load(id), actions.loadSystem()]);
    identity.scrollIntoView({ block: "nearest" });
  }

  async function remove(record) {
    await api.removeMachine(record);
    await actions.loadSystem();
    await load();
    write(removed, t("machine.removed", { name: record.name || record.id }));
    removed.scrollIntoView({ block: "nearest" });
  }

  async function choose(entry) {
    if (entry.cell !== "none") await actions.choose(entry.id);
    await load(entry.id).catch(actions.refuse);
  }

  async function edit(entry) {
    const who = identityCard(entry, async (change) => {
      try {
        await api.changeMachine(entry.id, change);
        await Promise.all([load(entry.id), actions.loadSystem()]);
        return true;
      } catch (error) {
        actions.refuse(error);
        return false;
      }
    });
    identity.replaceChildren(who, ...await configurationCards(entry));
  }

  /** Of a machine that is configured here: its axes, its devices while nothing drives it, its removal. */
  async function configurationCards(entry) {
    if (entry.origin !== "catalogue" || !mayDescribe()) return [];
    const record = await api.machineRecord(entry.id);
    const removal = removalCard(record, () => remove(record));
    const axes = describeCard(record.machine_file, async (_, described) => {
      await api.describeMachine(entry.id, described);
      await Promise.all([load(entry.id), actions.loadSystem()]);
    });
    if (entry.cell !== "none") return [axes, removal];
    const devices = deviceCard({ actions });
    devices.update({ machine_id: entry.id, job: null });
    return [axes, devices.element, removal];
  }

  load().catch(actions.refuse);
  return { update: showStates, close() {} };
}

/** What a machine is doing, in a word. */
function stateOf({ id, cell, connected }, { machine_id, machine, jobs }) {
  if (cell === "none") return t("machine.state_none");
  const job = jobs.find((one) => one.machine === id && isActive(one) && isMeasuring(one));
  if (job) return wordOf(job.state);
  const answers = id === machine_id ? isConnected(machine) : connected;
  return t(answers ? "connect.connected" : "connect.not_connected");
}

/** All calibrations of a machine; how it stands by the newest, and what has changed to it; null where nothing tells. */
async function standingOf(id) {
  const history = await api.machineHistory(id);
  const isKnown = history.calibrations.some((one) => one.verdict !== "not-usable");
  const standing = isKnown ? await api.machineStanding(id).catch(absent) : null;
  return { history, standing, changes: await changesOf(id, standing) };
}

/** What has changed since the calibration that the newest is held against; null where there is none. */
async function changesOf(id, standing) {
  if (!standing?.reference_job) return null;
  return api.machineChanges(id, standing.reference_job, standing.calibration).catch((error) => {
    api.expectProblem(error);
    return null; // other axes or targets: not comparable
  });
}

function absent(error) {
  if (!(error instanceof api.Problem) || error.status !== 404) throw error;
  return null;
}

function machineCard({ entry, history, standing, changes }, { chosen, several, choose }) {
  const newest = history?.calibrations.findLast((one) => one.verdict !== "not-usable") ?? null;
  const names = [[entry.maker, entry.model].filter(Boolean).join(" "), entry.serial_number && t("machine.number", { serial: entry.serial_number }), entry.place];
  return h("section", { class: "card machine-entry", "data-machine": entry.id, "data-alarm": Boolean(standing?.is_alarm) },
    h("div", { class: "device-icon" }, icon("machine")),
    h("div", {}, h("h2", {}, entry.name || entry.id), h("p", { class: "quiet" }, names.filter(Boolean).join(" · ") || t("machine.nameless")),
      h("p", { class: "machine-state" })),
    h("dl", { class: "machine-facts" }, fact(t("machine.calibrated"), newest ? dateTime(newest.measured) : t("machine.never"), newest && ageOf(newest.measured)),
      fact(t("machine.error_95"), newest ? wordEntry(history, newest, "p95") : "–", newest && t("machine.error_note")),
      changes && driftOf(changes)),
    standingMark(standing),
    several && h("button", { class: "button", "aria-pressed": String(entry.id === chosen), onclick: () => choose(entry) },
      entry.id === chosen && icon("check"), t(chooseWord(entry, chosen))));
}

function chooseWord({ id, cell }, chosen) {
  if (cell === "none") return "machine.identity";
  return id === chosen ? "machine.chosen" : "machine.choose";
}

const fact = (name, value, note) => h("div", {}, h("dt", {}, name), h("dd", {}, value), note && h("dd", { class: "quiet" }, note));

/** How long ago, in hours or whole days. */
function ageOf(stamp) {
  const age_ms = Math.max(0, Date.now() - new Date(stamp));
  if (age_ms < HOUR_MS) return t("machine.age_now");
  if (age_ms < 2 * DAY_MS) return t("machine.age_h", { hours: number(Math.floor(age_ms / HOUR_MS)) });
  return t("machine.age_days", { days: number(Math.floor(age_ms / DAY_MS)) });
}

/** How far the volume has moved between two calibrations, beside what chance alone would show. */
function driftOf({ since, volumetric: { difference_um: difference, by_chance_um: chance } }) {
  const digits = decimalsOf("error");
  return fact(t("machine.drift", { when: dateTime(since.measured) }), quantity(difference, "gap", digits),
    t("machine.drift_note", { chance: quantity(chance, "gap", digits) }));
}

function standingMark(standing) {
  // Where neither a tolerance nor an earlier calibration judges it, nothing says that all is well.
  const isJudged = standing?.tolerance === "within" || standing?.has_changed === false;
  const state = standing?.is_alarm ? "alarm" : isJudged && standing.tolerance !== "not-sure" ? "calm" : "unknown";
  return h("p", { class: "standing", "data-standing": state }, icon(SHAPES[state]), h("span", {}, wordsOf(standing).join(" ")));
}

function wordsOf(standing) {
  if (!standing?.calibration) return [t("machine.standing_unknown")];
  const { tolerance, has_changed: changed } = standing;
  return [t(`machine.tolerance_${tolerance ?? "none"}`), changed === null ? t("machine.change_unknown") : t(changed ? "machine.changed" : "machine.unchanged")];
}

const addCard = (save) => h("details", { class: "card", "data-card": "add" }, h("summary", {}, t("machine.add")),
  h("p", { class: "quiet" }, t("machine.add_text")), machineForm({ name: "add", asksId: true, label: t("machine.add"), save }));

const describeCard = (content, save) => h("details", { class: "card", "data-card": "describe" }, h("summary", {}, t("machine.describe")),
  h("p", { class: "quiet" }, t("machine.describe_text")), machineForm({ name: "describe", content, label: t("machine.save"), save }));

/** Who the machine is, which every certificate states, and what it may err by. */
function identityCard(entry, save) {
  const inputs = IDENTITY.map((name) => h("input", { id: `machine-${name}`, name, maxlength: 200, autocomplete: "off", value: entry[name] ?? "" }));
  const tolerance = toleranceField(entry.tolerance_um);
  const said = h("p", { class: "quiet", role: "status" });
  const button = h("button", { class: "button", type: "submit" }, t("machine.save"));
  const fields = h("fieldset", { class: "stack" }, h("div", { class: "text-fields" }, inputs.map((input) =>
    h("div", { class: "text-field" }, h("label", { for: input.id }, t(`machine.of_${input.name}`)), input)), tolerance.field), tolerance.note);
  const form = h("form", { class: "stack" }, fields, h("div", { class: "downloads" }, button, said));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const tolerance_um = tolerance.read();
    if (Number.isNaN(tolerance_um)) return;
    button.disabled = true;
    const isKept = await save({ ...Object.fromEntries(inputs.map((input) => [input.name, input.value.trim()])), tolerance_um });
    button.disabled = false;
    if (isKept) document.querySelector("[data-card=who] [role=status]").textContent = t("machine.saved");
  });
  const element = card(t("machine.who", { name: entry.name || entry.id }), h("p", { class: "quiet" }, t("machine.who_text")), form);
  element.dataset.card = "who";
  if (["viewer", "operator"].includes(document.body.dataset.role)) {
    fields.disabled = true;
    button.hidden = true;
    said.textContent = t("session.metrologist_only");
  }
  return element;
}

/** What 95 % of the places may err by; `read()` is in µm, null where none is stated, NaN where it is no number above 0. */
function toleranceField(kept) {
  const text = typeof kept === "number" ? plain(shown(kept, "gap"), decimalsOf("gap")) : "";
  const error = h("p", { class: "field-error", id: "machine-tolerance-error", role: "alert" });
  const input = h("input", { id: "machine-tolerance", inputmode: "decimal", autocomplete: "off", placeholder: t("headline.none"),
    "aria-describedby": "machine-tolerance-note machine-tolerance-error", value: text });

  function read() {
    if (input.value === text) return kept ?? null; // no digit is lost where nothing was typed
    const wanted = typed(input.value);
    const isGood = wanted === null || wanted > 0;
    mark(input, "aria-invalid", isGood ? null : "true");
    write(error, isGood ? "" : t("headline.tolerance_refused"));
    if (!isGood) return NaN;
    return wanted === null ? null : stored(wanted, "gap");
  }

  const field = h("div", { class: "text-field" }, h("label", { for: input.id }, t("machine.tolerance"), h("span", { class: "unit" }, unitOf("gap"))), input);
  const note = h("div", {}, h("p", { class: "field-note", id: "machine-tolerance-note" }, t("machine.tolerance_note")), error);
  return { field, note, read };
}

/** Card that removes a machine; `remove()` refuses with a Problem. */
function removalCard({ id, name }, remove) {
  const error = h("p", { class: "field-error", role: "alert" });
  const button = h("button", { class: "button", id: "machine-remove" },
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
