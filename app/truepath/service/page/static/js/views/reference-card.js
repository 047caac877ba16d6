/* A result against a direct measurement that the operator has as a file. */
import * as api from "../api.js";
import { h, icon, mark } from "../dom.js";
import { linkButton, problemNotice, tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { nameOfAny } from "../tables.js";
import { number, t, typed } from "../texts.js";
import { quantity, stored, unitOf } from "../units.js";

/** The card: choose the file, state what its instrument is uncertain by, see both side by side. */
export function referenceCard(job) {
  const answer = h("div", { class: "stack", "aria-live": "polite" });
  const fields = [uncertaintyField("reference_um", "error", check), uncertaintyField("reference_urad", "angle", check)];
  const file = h("input", { type: "file", accept: ".csv,text/csv", hidden: true, "aria-label": t("reference.choose") });
  const button = h("button", { class: "button", onclick: () => file.click() }, icon("upload"), t("reference.choose"));
  file.addEventListener("change", () => send(file.files[0]));

  function check() {
    button.disabled = fields.some(({ read }) => Number.isNaN(read()));
  }

  async function send(chosen) {
    if (!chosen) return;
    button.disabled = true;
    const stated = Object.fromEntries(fields.map(({ name, read }) => [name, read() / COVERAGE]));
    try {
      answer.replaceChildren(h("p", { class: "quiet" }, t("upload.sending")));
      answer.replaceChildren(...describe(await api.compareWithReference(job.id, chosen, stated)));
    } catch (error) {
      api.expectProblem(error);
      answer.replaceChildren(problemNotice(error));
    } finally {
      file.value = "";
      check();
    }
  }

  return h("section", { class: "card stack", "data-card": "reference", "data-needs": "metrologist" }, h("h2", {}, t("reference.title")),
    h("p", { class: "quiet" }, t("reference.text")), h("div", { class: "text-fields" }, fields.map(({ element }) => element)),
    h("div", {}, file, button), answer);
}

/** What the reference is uncertain by, k = 2 as everywhere on the page; 0 where it is left empty, NaN where it is nonsense. */
function uncertaintyField(name, kind, changed) {
  const error = h("p", { class: "field-error", id: `${name}-error`, role: "status" });
  const input = h("input", { id: name, inputmode: "decimal", autocomplete: "off", placeholder: t("headline.none"), "aria-describedby": `${name}-error` });
  const read = () => {
    const value = typed(input.value);
    return value === null ? 0 : value >= 0 ? stored(value, kind) : NaN;
  };
  input.addEventListener("input", () => {
    const isBad = Number.isNaN(read());
    mark(input, "aria-invalid", isBad ? "true" : null);
    error.textContent = isBad ? t("reference.refused") : "";
    changed();
  });
  const label = t(`reference.of_${kind}`, { k: COVERAGE, unit: unitOf(kind) });
  return { name, read, element: h("div", { class: "text-field" }, h("label", { for: name }, label), input, error) };
}

function describe({ errors, numbers, volumetric, not_compared: left_out, links }) {
  const rows = [...Object.entries(errors).map(ofTable), ...Object.entries(numbers).map(ofNumber)].sort((a, b) => b.en - a.en);
  const beyond = rows.filter(({ en }) => en > 1).length;
  const missing = Object.keys(left_out);
  return [
    h("p", {}, h("strong", {}, t(beyond ? "reference.beyond" : "reference.within", { count: number(beyond), total: number(rows.length) }))),
    volumetric && h("p", {}, t("reference.volumetric", { result: quantity(volumetric.result_mean_um, "gap"),
      reference: quantity(volumetric.reference_mean_um, "gap"), difference: quantity(volumetric.difference_mean_um, "gap") })),
    tableFrame(t("reference.title"), h("table", { class: "compare" },
      h("thead", {}, h("tr", {}, h("th", {}, t("result.symbol")), ["difference", "en", "share"].map((name) => h("th", { class: "right" }, t(`reference.${name}`))), h("th", {}, ""))),
      h("tbody", {}, rows.map(row)))),
    h("p", { class: "quiet" }, t("reference.note", { k: COVERAGE }), missing.length > 0 && ` ${t("reference.left_out", { symbols: missing.join(", ") })}`),
    h("div", {}, linkButton(links.report_html, "report", t("result.report"), { target: "_blank", rel: "noopener" })),
  ].filter(Boolean);
}

/** A value in µm, or in µrad where there is none. */
const measured = (um, urad) => (typeof um === "number" ? quantity(um, "error") : quantity(urad, "angle"));

const ofTable = ([symbol, one]) => ({ symbol, en: one.largest_en, share: one.share_within,
  difference: measured(one.largest_difference_um, one.largest_difference_urad) });

const ofNumber = ([symbol, one]) => ({ symbol, en: Math.abs(one.en), share: Number(Math.abs(one.en) <= 1),
  difference: measured(one.difference_um, one.difference_urad) });

const row = ({ symbol, difference, en, share }) => h("tr", { "data-changed": en > 1 },
  h("td", {}, h("span", { class: "symbol" }, symbol), " ", h("span", { class: "quiet" }, nameOfAny(symbol))),
  h("td", { class: "right" }, difference), h("td", { class: "right" }, number(en, 2)), h("td", { class: "right" }, `${number(100 * share)} %`),
  h("td", { class: "right" }, en > 1 && h("span", { class: "changed" }, icon("warning"), t("reference.is_beyond"))));
