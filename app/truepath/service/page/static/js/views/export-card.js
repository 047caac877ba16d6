/* The files that a controller corrects by: what they leave is seen before they are taken. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { bars, card, linkButton, notice, pairs, problemNotice, segments, wordFormat } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { sayUnmeasured } from "../statements.js";
import { known, t } from "../texts.js";
import { decimalsOf, figure, quantity } from "../units.js";

/** Whether files are for the control that a machine is said to have. */
export const isOwn = ({ control }, own) => own.toLowerCase().includes(control.split(/[\s,]/)[0].toLowerCase());

/** A card with a choice of controllers, that of the machine first and chosen; null where the result is not to be used.
 *
 * stated_um: mean volumetric error that the result states, where it states one; own: the machine's control; onFiles(): hears that files were made
 */
export function exportCard(job, { verdict, stated_um, own }, onFiles) {
  if (verdict?.state === "not-usable" || verdict === "not-usable") return null;
  const choices = h("div", { class: "choices", role: "radiogroup", "aria-label": t("export.choose") });
  const ways = h("div");
  const said = h("div", { class: "stack", "aria-live": "polite" });
  let carried = "";
  let order = { format: null, unmeasured: "hold", choices: {}, difference: false, active_files: {} };

  /** Have the files made and say what they leave; a later choice makes an earlier one void. */
  async function choose(change) {
    const asked = { ...order, ...change };
    order = asked;
    if (!asked.format) return;
    said.replaceChildren(h("p", { class: "quiet" }, t("export.computing")));
    const made = await api.createCompensation(job.id, asked).then(take, (error) => refusal(error, choose));
    if (order === asked) said.replaceChildren(...made);
  }

  function take(made) {
    onFiles();
    return [...basisOf(made, order, choose), ...account(made, order, stated_um, carried)];
  }

  /** Choose a format as its control usually has it, and show what else may be chosen of it. */
  function chooseFormat(format) {
    carried = wordFormat(format.name, "carries", format.carries);
    const usual = Object.entries(format.choices).map(([name, [first]]) => [name, first]);
    ways.replaceChildren(...Object.entries(format.choices).map(([name, words]) => wayField(name, words,
      (word) => choose({ choices: { ...order.choices, [name]: word } }))));
    choose({ format: format.name, choices: Object.fromEntries(usual), difference: false, active_files: {} });
  }

  const beyond = segments(t("export.unmeasured"),
    ["hold", "fade", "refuse"].map((choice) => [choice, t(`export.unmeasured_${choice}`)]), order.unmeasured,
    (unmeasured) => choose({ unmeasured }));
  const element = card(t("export.choose"), choices, ways,
    h("div", { class: "choice-beside" }, h("span", {}, t("export.unmeasured")), beyond), said);
  element.hidden = true;
  element.dataset.card = "export";
  element.dataset.needs = "metrologist";
  // Without the list there is no card: the result stands all the same.
  api.formats().then((formats) => {
    const [first, ...others] = formats.sort((a, b) => isOwn(b, own) - isOwn(a, own)).map((format) => choice(format, () => chooseFormat(format)));
    choices.append(first, ...others);
    element.hidden = false;
    if (isOwn(formats[0], own) && first.checkVisibility()) first.click();
  }, () => {});
  return element;
}

/** One of the choices; they are radio buttons of one group. */
function choice({ name, control }, chosen) {
  const button = h("button", { class: "choice", role: "radio", "aria-checked": "false",
    "data-format": name, onclick: () => {
      for (const other of button.parentElement.children) other.setAttribute("aria-checked", String(other === button));
      chosen();
    } }, h("strong", {}, wordFormat(name, "control", control)));
  return button;
}

/** How one thing of a format is written; the first word is usual. */
function wayField(name, words, choose) {
  const label = known(`export.choice.${name}`, name);
  return h("div", { class: "choice-beside", "data-way": name }, h("span", {}, label),
    segments(label, words.map((word) => [word, known(`export.word.${word}`, word)]), words[0], choose));
}

/** The maker's note in words of this page: some choices have one of their own. */
function noteOf({ format, note }, choices) {
  const own = Object.values(choices).map((word) => known(`format.${format}.note_${word}`, null)).find(Boolean);
  return own ?? wordFormat(format, "note", note);
}

/** What the files leave, what they lack, what to do with them, and the way to take them. */
function account(made, { choices, unmeasured }, stated_um, carried) {
  const { before, after, after_where_measured: inside } = made.volumetric_error_um;
  const rows = [
    [t("export.carries"), carried],
    made.unmeasured.length && inside && [t("export.inside"), left(inside)],
    [t("export.not_carried"), wordFormat(made.format, "not_carried", made.not_carried)],
  ].filter(Boolean);
  return [
    bars([[t("export.before"), before.mean, quantity(before.mean, "gap"), "is-before"], [t("export.after"), after.mean, left(after), "is-after"]],
      Math.max(before.mean, after.mean)),
    h("div", { class: "downloads", role: "group", "aria-label": t("export.title") },
      linkButton(made.links.archive, "download", t("export.take"), { download: "" })),
    pairs(rows),
    h("p", { class: "quiet" }, [t("export.on_places"), stated_um !== undefined && t("export.on_grid", { value: quantity(stated_um, "gap", decimalsOf("error")) })].filter(Boolean).join(" ")),
    ...rotaryAccount(made),
    !made.sign.verified && notice("held", t("export.sign"), t("export.sign_text")),
    made.unmeasured.length > 0 && h("ul", { class: "lines" }, made.unmeasured.map((text) => h("li", {}, sayUnmeasured(text, unmeasured)))),
    h("p", { class: "quiet" }, noteOf(made, choices)),
  ].filter(Boolean);
}

const left = ({ mean, mean_uncertainty: u }) =>
  t("export.left", { value: quantity(mean, "gap"), u: quantity(COVERAGE * u, "gap"), k: COVERAGE });

/** Whether the files are the whole, combined with active tables or the difference to these; which of both may be chosen. */
function basisOf({ basis }, { difference }, choose) {
  if (!basis) return [];
  const ways = basis.control_compensation === "on" && segments(t("export.tables"),
    [["combined", t("export.combined")], ["difference", t("export.difference")]], difference ? "difference" : "combined",
    (way) => choose({ difference: way === "difference", active_files: {} }));
  return [ways && h("div", { class: "choice-beside", "data-way": "tables" }, h("span", {}, t("export.tables")), ways),
    notice(basis.holds === "difference" ? "held" : null, t(`export.holds.${basis.holds}`), t(`export.holds_text.${basis.holds}`))].filter(Boolean);
}

/** The problem; where active tables are wanted, a field for their files, or the difference instead. */
function refusal(error, choose) {
  api.expectProblem(error);
  if (error.code !== "active-tables-unknown") return [problemNotice(error)];
  const files = h("input", { type: "file", multiple: true, "aria-label": t("export.active_files"), onchange: async () => {
    const read = [...files.files].map(async (file) => [file.name, await file.text()]);
    choose({ active_files: Object.fromEntries(await Promise.all(read)), difference: false });
  } });
  return [problemNotice(error), h("label", { class: "choice-beside" }, h("span", {}, t("export.active_files")), files),
    h("button", { class: "button", onclick: () => choose({ difference: true, active_files: {} }) }, t("export.difference"))];
}

/** Sections of an account; none for a machine of straight axes. */
function rotaryAccount({ over_all_axes_um: over, rotary = {} }) {
  if (!over) return [];
  return [h("section", { class: "stack", "data-rotary": "" },
    h("h3", {}, t("export.rotary")),
    pairs(overAxes(over)),
    Object.entries(rotary).map(([axis, left]) => [h("h3", {}, t("result.axis", { axis })), pairs(rowsOf(left))]),
    h("p", { class: "quiet" }, t("export.rotary_note")))];
}

/** Mean error over the travel of all axes; without uncertainties where an earlier version made the files. */
function overAxes({ before, before_expanded_uncertainty: u, after, after_expected: expected, after_expanded_uncertainty: left }) {
  return [
    [t("export.all_axes_before"), stated(before, u, "gap")],
    [t("export.after"), stated(expected ?? after, left, "gap")],
  ];
}

function rowsOf(left) {
  return [
    [t("export.rotary_angle"), left.positioning_urad ? change(left.positioning_urad, "angle") : t("export.rotary_not_stated")],
    left.at_tool_um && [t("export.rotary_at_tool"), change(left.at_tool_um, "gap")],
    left.location_at_tool_um && [t("export.rotary_location"), change(left.location_at_tool_um, "gap")],
    lostMotion(left),
    [t("export.not_carried"), left.not_in_files.join(", ") || t("export.rotary_nothing")],
  ].filter(Boolean);
}

/** Said as well where the result has none; nothing of files that an earlier version made. */
function lostMotion({ lost_motion: words, lost_motion_urad: lost }) {
  if (!words) return null;
  return [t("export.rotary_lost"), lost ? change(lost, "angle") : t("export.rotary_not_stated")];
}

const change = ({ before, after, after_expected: expected, after_expanded_uncertainty: u }, kind) =>
  t("export.rotary_change", { before: figure(before, kind), after: stated(expected ?? after, u, kind) });

const stated = (value, u, kind) => (typeof u === "number"
  ? t("export.left", { value: quantity(value, kind), u: quantity(u, kind), k: COVERAGE })
  : quantity(value, kind));
