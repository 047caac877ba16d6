/* Where the tracker may stand: chosen by the plan on the sides of the travel that are free. */
import { h, mark, write } from "../dom.js";
import { LINEAR } from "../keep-out.js";
import { fold, segments } from "../parts.js";
import { recall, retain } from "../preferences.js";
import { t } from "../texts.js";
import { numberField, within } from "./number-field.js";

const SIDES = ["left", "right", "front", "back"];
const OFF_MM = { least: 100, most: 50000, step: 250 };
const HEIGHT_MM = { most: 20000, step: 50 };
const site = recall("site", { chosen: false, count: 1, sides: SIDES, near_mm: 500, far_mm: 2500, height_mm: null });

/** How many stations share the time. */
export const stationCount = () => (site.chosen ? site.count : 1);

/** Whether the plan chooses the tracker's place. */
export const choosesPlace = () => site.chosen;

/** Why no plan can be asked for with these areas; empty where one can. */
export function refusePlace() {
  if (!site.chosen) return "";
  if (!site.sides.length) return t("place.sides_refused");
  const { near_mm, far_mm, height_mm } = site;
  const off = OFF_MM.least <= near_mm && near_mm <= far_mm && far_mm <= OFF_MM.most;
  return off && within(height_mm, -HEIGHT_MM.most, HEIGHT_MM.most) ? "" : t("place.limits_refused");
}

/** What a plan is asked of the tracker's place; nothing where it stays as it is. */
export function placeOrder(machine) {
  if (!site.chosen) return {};
  const areas = SIDES.filter((side) => site.sides.includes(side)).map((side) => areaOf(side, machine));
  return { workspace: { tracker: { areas } }, stations: site.count };
}

/** A flat area beside the travel; its corners belong to front and back. */
function areaOf(side, machine) {
  const [x, y, z] = travelOf(machine);
  const [near, far] = [site.near_mm, site.far_mm];
  const wide = [x[0] - far, x[1] + far];
  const [xs, ys] = {
    left: [[x[0] - far, x[0] - near], y], right: [[x[1] + near, x[1] + far], y],
    front: [wide, [y[0] - far, y[0] - near]], back: [wide, [y[1] + near, y[1] + far]],
  }[side];
  const height = site.height_mm ?? (z[0] + z[1]) / 2;
  return { name: t(`place.${side}`), min_mm: [xs[0], ys[0], height], max_mm: [xs[1], ys[1], height] };
}

/** Ends of X, Y and Z; 0 where the machine has none. */
export const travelOf = (machine) => LINEAR.map((name) => {
  const { min_mm = 0, max_mm = 0 } = machine?.axes?.[name] ?? {};
  return [min_mm, max_mm];
});

/** The card that asks for it. */
export function placeCard(tell) {
  const changed = () => {
    retain("site", site);
    tell();
  };
  const details = h("div", { class: "stack" }, countField(changed), sidesField(changed),
    ...["near_mm", "far_mm"].map((name) => offField(name, changed).element), heightField(changed).element);
  const choices = [[false, "stays"], [true, "chosen"]].map(([chosen, name]) =>
    h("button", { class: "choice", role: "radio", "data-place": name,
      onclick: () => choose(chosen) }, h("strong", {}, t(`place.${name}`)), h("span", {}, t(`place.${name}_note`))));

  function choose(chosen) {
    site.chosen = chosen;
    show();
    changed();
  }

  function show() {
    choices.forEach((choice, i) => mark(choice, "aria-checked", String(Boolean(i) === site.chosen)));
    details.hidden = !site.chosen;
    write(card.value, t(`place.${site.chosen ? "chosen" : "stays"}`));
  }

  const card = fold("place", t("place.title"), h("div", { class: "stack", role: "radiogroup", "aria-label": t("place.title") }, choices), details);
  show();
  return card;
}

function countField(changed) {
  const keep = (count) => {
    site.count = Number(count);
    changed();
  };
  return h("div", { class: "field" }, h("span", { class: "label" }, t("place.count")),
    segments(t("place.count"), ["1", "2", "3"].map((n) => [n, n]), String(site.count), keep),
    h("p", { class: "field-note" }, t("place.count_note")));
}

function sidesField(changed) {
  const toggles = SIDES.map((side) => h("button", { "data-side": side,
    "aria-pressed": String(site.sides.includes(side)), onclick: (event) => toggle(side, event.currentTarget) },
  t(`place.${side}`)));

  function toggle(side, button) {
    site.sides = site.sides.includes(side) ? site.sides.filter((other) => other !== side) : [...site.sides, side];
    mark(button, "aria-pressed", String(site.sides.includes(side)));
    changed();
  }

  return h("div", { class: "field" }, h("span", { class: "label" }, t("place.sides")),
    h("div", { class: "segments is-small is-several", role: "group", "aria-label": t("place.sides") }, toggles),
    h("p", { class: "field-note" }, t("place.sides_note")));
}

function offField(name, changed) {
  const { least, most, step } = OFF_MM;
  return numberField({
    id: name.replace("_mm", ""), kind: "travel", label: t(`place.${name}`), note: t(`place.${name}_note`),
    less: t("place.less"), more: t("place.more"), least, most,
    get: () => site[name] ?? NaN, set: keepIn(name, changed),
    next: (value, direction) => (Math.round((value ?? 0) / step) + direction) * step,
  });
}

function heightField(changed) {
  const { most, step } = HEIGHT_MM;
  return numberField({
    id: "height", kind: "travel", label: t("place.height"), note: t("place.height_note"),
    less: t("place.less"), more: t("place.more"), none: t("place.height_none"), least: -most, most,
    get: () => site.height_mm, set: keepIn("height_mm", changed),
    next: (value, direction) => (Math.round((value ?? 0) / step) + direction) * step,
  });
}

const keepIn = (name, changed) => (value) => {
  site[name] = value;
  changed();
};
