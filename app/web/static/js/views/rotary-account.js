/* What compensation files leave of rotary axes: over all axes, of each axis, and what a format cannot carry. */
import { h } from "../dom.js";
import { pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { t } from "../texts.js";
import { figure, quantity } from "../units.js";

/** Sections of an account; none for a machine of straight axes. */
export function rotaryAccount({ over_all_axes_um: over, rotary = {} }) {
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
