/* Where simulation and measurement disagree: what explains most of it, before and after. */
import { h } from "../dom.js";
import { card } from "../parts.js";
import { known, number, t } from "../texts.js";

const SHOWN = 6;

/** A card with a bar for each grouping; null where the discovery does not tell. */
export function whereCard(explained) {
  if (!explained) return null;
  const { before, after } = explained;
  const rows = Object.entries(before).sort(([, a], [, b]) => b - a).slice(0, SHOWN);
  const highest = Math.max(...rows.map(([name, share]) => Math.max(share, after[name] ?? 0)), 0.01);
  const bar = (share, kind) => {
    const inside = h("i", { class: kind });
    inside.style.width = `${(100 * share) / highest}%`;
    return inside;
  };
  const percent = (share) => number(100 * share, 0);
  const row = ([name, share]) => [h("dt", {}, wordOf(name)),
    h("dd", {}, h("div", { "aria-hidden": "true" }, bar(share, "is-before"), bar(after[name] ?? 0, "is-after")),
      h("span", {}, t("where.share", { before: percent(share), after: percent(after[name] ?? 0) })))];
  const element = card(t("where.title"), h("p", { class: "quiet" }, t("where.text")),
    h("dl", { class: "shares" }, rows.map(row)));
  element.dataset.where = "";
  return element;
}

/** A grouping in words: "position of X", "region of X and Y", "moving axis", "time". */
function wordOf(name) {
  const [group, of = ""] = name.split(" of ");
  const [one, other] = of.split(" and ");
  const key = `where.${group.split(" ")[0]}`;
  return known(key, "") ? t(key, { of: known(`sensor.${of}`, of), one, other }) : name;
}
