/* Sheets over the view. Not modal: the rest, Abort above all, stays within reach. */
import { h } from "./dom.js";
import { t } from "./texts.js";

let opener = null;

/** Open a sheet and give it the focus; another one closes. */
export function openSheet(sheet) {
  for (const other of document.querySelectorAll("dialog[open]")) other.close();
  opener = document.activeElement;
  sheet.show();
  sheet.querySelector("button, [tabindex]")?.focus();
}

/** Title of a sheet, and what closes it. */
export const sheetHead = (sheet, title) => h("div", { class: "sheet-head" }, h("h2", { id: `${sheet.id}-title` }, title),
  h("button", { class: "button", onclick: () => closeSheet(sheet) }, t("shell.close")));

/** Close a sheet and give the focus back. */
export function closeSheet(sheet) {
  sheet.close();
  opener?.focus();
}

document.addEventListener("keydown", (event) => {
  const open = document.querySelector("dialog[open]");
  if (event.key === "Escape" && open) closeSheet(open);
});
document.addEventListener("pointerdown", (event) => {
  const open = document.querySelector("dialog[open]");
  const kept = open?.contains(event.target) || event.target.closest(".abort-form, .abort-sheet");
  if (open && !kept && !opener?.contains(event.target)) open.close();
});
