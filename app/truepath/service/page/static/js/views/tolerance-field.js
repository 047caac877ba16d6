/* The tolerance that this panel keeps: typed with a result or before a verification. */
import { h, mark, write } from "../dom.js";
import { prefer, preference } from "../preferences.js";
import { plain, t, typed } from "../texts.js";
import { shown, stored, unitOf } from "../units.js";

/** What was typed last, in µm; null where nothing was. */
export const keptTolerance = () => Number(preference("tolerance_um")) || null;

/** The field; `changed(tolerance_um)` hears of each change, null where it is empty, NaN where it is nonsense. */
export function toleranceField(id, label, changed) {
  const error = h("p", { class: "field-error", id: `${id}-error`, role: "status" });
  const input = h("input", { id, inputmode: "decimal", autocomplete: "off", placeholder: t("headline.none"), "aria-describedby": error.id,
    value: keptTolerance() === null ? "" : plain(shown(keptTolerance(), "gap"), 2) });
  input.addEventListener("input", () => {
    const wanted = typed(input.value);
    const isGood = wanted === null || wanted > 0;
    const tolerance_um = wanted === null ? null : stored(wanted, "gap");
    mark(input, "aria-invalid", isGood ? null : "true");
    write(error, isGood ? "" : t("headline.tolerance_refused"));
    if (isGood) prefer("tolerance_um", tolerance_um ?? "");
    changed(isGood ? tolerance_um : NaN);
  });
  return h("div", { class: "tolerance" }, h("label", { for: id }, label), input, h("span", { class: "unit" }, unitOf("gap")), error);
}
