/* Which Runs tell how the machine changes, when they were, and what it may be off by. */
import { h, icon } from "../dom.js";
import { card, tableFrame } from "../parts.js";
import { dateTime, named, t } from "../texts.js";
import { numberField, within } from "./number-field.js";

const LEAST_UM = 0.01;
const MOST_UM = 1e4;
const HORIZON_H = 24;
const LATER_H = [1, 2, 4, 8, 16, 24];

/** Runs of the machine that most of them are of, the oldest first. */
export function runsOfOneMachine(runs) {
  const machines = runs.map((run) => run.machine);
  const count = (machine) => machines.filter((other) => other === machine).length;
  const most = [...new Set(machines)].sort((a, b) => count(b) - count(a))[0];
  return runs.filter((run) => run.machine === most).sort((a, b) => (a.created < b.created ? -1 : 1));
}

/** The form; `lead` is the button that asks. */
export function trendForm(store) {
  const chosen = new Map(); // id of a Run: text of its hours
  let limit_um = 5;
  let shown = null;
  const list = tableFrame(t("trend.runs"));
  const field = numberField({ id: "trend-limit", kind: "error", label: t("trend.limit"), note: t("trend.limit_note"),
    less: t("trend.limit_less"), more: t("trend.limit_more"), none: t("trend.none"), least: LEAST_UM, most: MOST_UM,
    get: () => limit_um, set: (value) => { limit_um = value; tell(); },
    next: (value, direction) => Math.max(1, (value ?? 5) + direction) });
  const element = h("div", { class: "stack" },
    card(t("trend.choose"), h("p", { class: "quiet" }, t("trend.choose_text")), list), card(t("trend.ask_title"), field.element));
  const tell = () => store.set({});

  function update({ runs }) {
    if (runs === shown) return;
    shown = runs;
    const known = runsOfOneMachine(runs);
    list.replaceChildren(known.length < 2 ? h("p", { class: "empty" }, t("trend.too_few"))
      : table(known));
  }

  function table(runs) {
    const titles = [t("trend.use"), t("records.name"), t("records.created"), t("trend.at")];
    return h("table", {}, h("thead", {}, h("tr", {}, titles.map((title) => h("th", {}, title)))),
      h("tbody", {}, runs.map(row)));
  }

  function row(run) {
    const name = named(run.name);
    const hours = h("input", { inputmode: "decimal", autocomplete: "off", class: "hours", "aria-label": `${t("trend.at")}: ${name}`,
      oninput: () => { if (chosen.has(run.id)) chosen.set(run.id, hours.value); tell(); } });
    const use = h("input", { type: "checkbox", class: "use", "aria-label": name,
      onchange: () => {
        if (use.checked) chosen.set(run.id, hours.value);
        else chosen.delete(run.id);
        tell();
      } });
    return h("tr", { "data-run": run.id }, h("td", {}, h("label", { class: "use-cell" }, use)), h("td", {}, name),
      h("td", {}, dateTime(run.created)), h("td", {}, hours));
  }

  /** What is asked; times as stated, in their order, or none where none are. */
  function order() {
    const known = runsOfOneMachine(shown ?? []).filter((run) => chosen.has(run.id));
    const times = known.map((run) => parse(chosen.get(run.id)));
    const stated = times.some((time) => time !== null);
    const pairs = known.map((run, i) => [run.id, times[i]]);
    if (stated) pairs.sort((a, b) => a[1] - b[1]);
    const more = stated ? { at_h: pairs.map(([, time]) => time) } : {};
    const wrong = stated && times.some((time) => time === null || !Number.isFinite(time));
    return { wrong, body: { kind: "trend", run_ids: pairs.map(([id]) => id), ...more, limit_um,
      horizon_h: HORIZON_H, later_h: LATER_H } };
  }

  function lead({ busy }, actions) {
    const { wrong, body } = order();
    const reason = body.run_ids.length < 2 ? t("trend.choose_two") : wrong ? t("trend.state_all") : "";
    const bad = !within(limit_um, LEAST_UM, MOST_UM);
    return { reason, next: { key: "follow", label: t("trend.ask"), disabled: Boolean(busy || reason || bad),
      run: () => actions.prepare(order().body) } };
  }

  return { element, update, lead };
}

/** Hours as typed, with either decimal sign; null where nothing is. */
const parse = (text) => (text.trim() === "" ? null : Number(text.trim().replace(",", ".")));

/** A card that leads here, where a machine has two Runs or more; else null. */
export function overTimeCard(runs, go) {
  if (runsOfOneMachine(runs).length < 2) return null;
  return card(t("trend.title"), h("p", { class: "quiet" }, t("trend.text")),
    h("div", {}, h("button", { class: "button", onclick: () => go("#/trend") },
      icon("records"), h("span", {}, t("trend.open")))));
}
