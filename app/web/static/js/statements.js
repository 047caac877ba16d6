/* Statements that the service makes in English, in the language of the page. */
import { nameOf } from "./tables.js";
import { currentLanguage, number, t } from "./texts.js";

const MERGED = /^(E[XYZABC]{2}) \(.*?\) cannot be told from (.+?) with /;
const REMEDIES = { by_tool: /at least (\d+) mm longer or shorter/, by_side: /at least (\d+) mm to the side/ };
const UNMEASURED = /^(\S+) not measured from (.+) mm: /;

/** What an error motion cannot be told from, and what would; a statement of another form stands as it is. */
export function sayUnobservable(text) {
  const found = MERGED.exec(text);
  if (currentLanguage() === "en" || !found) return text;
  const [, symbol, others] = found;
  const said = [t("unobservable.merged", { symbol, name: nameOf(symbol), others: others.replaceAll(" and ", ` ${t("statement.and")} `) })];
  for (const [key, pattern] of Object.entries(REMEDIES)) {
    const remedy = pattern.exec(text);
    if (remedy) said.push(t(`unobservable.${key}`, { length: number(remedy[1]) }));
  }
  return said.join(" ");
}

/** Where an axis was not measured, and the choice (hold, fade) of what its table has there. */
export function sayUnmeasured(text, choice) {
  const found = UNMEASURED.exec(text);
  if (currentLanguage() === "en" || !found) return text;
  const parts = found[2].split(" and ").map((part) => {
    const [from, to] = part.split(" to ").map((end) => number(end, (end.split(".")[1] ?? "").length));
    return t("statement.from_to", { from, to });
  });
  return t("export.axis_unmeasured", { axis: found[1], parts: parts.join(` ${t("statement.and")} `), choice: t(`export.unmeasured_${choice}`) });
}
