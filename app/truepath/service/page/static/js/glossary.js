/* Words of the field and what they mean: one list, which opens where one of them is pressed. */
import { h } from "./dom.js";
import { openSheet, sheetHead } from "./sheets.js";
import { known, t } from "./texts.js";

const TERMS = ["uncertainty", "k", "volumetric", "decision", "grade", "configuration", "error_motion", "squareness", "lost_motion", "circle", "keep_out"];

/** A word that opens the glossary at its entry; `text` where it stands for another one. */
export const term = (name, text = t(`glossary.${name}`)) => h("button", { class: "term", "data-term": name, onclick: () => openGlossary(name) }, text);

function openGlossary(name) {
  const sheet = document.getElementById("detail");
  sheet.replaceChildren(sheetHead(sheet, t("glossary.title")), h("dl", { class: "glossary" }, TERMS.map((one) =>
    h("div", { "aria-current": one === name && "true" }, h("dt", {}, t(`glossary.${one}`)), h("dd", {}, known(`glossary.${one}_means`, ""))))));
  openSheet(sheet);
  sheet.querySelector("[aria-current]").scrollIntoView({ block: "center" });
}
