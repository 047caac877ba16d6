/* Units, light or dark, language. */
import { h } from "../dom.js";
import { segments } from "../parts.js";
import { prefer, preference, rememberLanguage } from "../preferences.js";
import { isLoggedIn, logOut } from "../session.js";
import { closeSheet, openSheet } from "../sheets.js";
import { currentLanguage, languages, speak, t } from "../texts.js";

const NAMES = { en: "English", de: "Deutsch" };

/** Open or close the sheet; `changed` after each choice. */
export function toggleSettings(changed) {
  const sheet = document.getElementById("settings");
  if (sheet.open) {
    closeSheet(sheet);
    return;
  }
  fill(sheet, changed);
  openSheet(sheet);
}

function fill(sheet, changed) {
  const field = (label, choice) => h("div", { class: "field" }, h("span", { class: "label" }, label), choice);
  const set = (name, after = () => {}) => (value) => {
    prefer(name, value);
    after();
    changed();
  };
  const themed = () => document.dispatchEvent(new CustomEvent("truepath:theme"));
  const spoken = async (value) => {
    rememberLanguage(value);
    await speak(value);
    fill(sheet, changed);
    changed();
  };
  sheet.replaceChildren(
    h("div", { class: "sheet-head" }, h("h2", { id: "settings-title" }, t("settings.title")),
      h("button", { class: "button", onclick: () => closeSheet(sheet) }, t("shell.close"))),
    field(t("settings.units"), segments(t("settings.units"),
      [["mm", "mm"], ["inch", t("settings.inch")]], preference("units"), set("units"))),
    field(t("settings.theme"), segments(t("settings.theme"),
      ["auto", "light", "dark"].map((v) => [v, t(`settings.${v}`)]), preference("theme"), set("theme", themed))),
    field(t("settings.language"), segments(t("settings.language"),
      languages.map((v) => [v, NAMES[v] ?? v]), currentLanguage(), spoken)),
    isLoggedIn() && h("div", { class: "field" }, h("button", { class: "button", onclick: logOut }, t("session.log_out"))),
    h("p", { class: "quiet", style: "margin-top: 20px" }, t("settings.note")),
    h("p", { class: "quiet number" }, `Truepath ${document.body.dataset.version}`),
  );
}
