/* The map in numbers: at ends and middles of the travel, for who cannot see the picture. */
import { h } from "../dom.js";
import { tableFrame } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { t } from "../texts.js";
import { figure, unitOf } from "../units.js";

/** A table that is written when it is opened. */
export function mapTable(map) {
  const content = tableFrame(t("map.table"));
  const details = h("details", { class: "map-table" }, h("summary", {}, t("map.table")), content);
  details.addEventListener("toggle", () => {
    if (details.open && !content.children.length) content.append(table(map));
  });
  return details;
}

function table({ points, levels, hasDirection, isScattered }) {
  const kept = levels.map((own) => new Set([0, Math.floor((own.length - 1) / 2), own.length - 1]));
  const rows = isScattered ? points : points.filter(({ index }) => index.every((i, k) => kept[k].has(i)));
  const title = (text) => h("th", { class: "right", scope: "col" }, text);
  const micro = unitOf("gap");
  return h("table", {},
    h("thead", {}, h("tr", {}, ["X", "Y", "Z"].map((name) => title(`${name} (${unitOf("travel")})`)),
      hasDirection && ["δx", "δy", "δz"].map((name) => title(`${name} ± U (${micro})`)), title(`${t("map.length")} (${micro})`),
      h("th", { scope: "col" }, t("map.range")))),
    h("tbody", {}, rows.map(({ at_mm, error_um, expanded_um, length_um, isMeasured }) => h("tr", {},
      at_mm.map((v) => h("td", { class: "right" }, figure(v, "travel"))),
      hasDirection && error_um.map((v, i) => h("td", { class: "right" }, `${figure(v, "gap")} ± ${figure(expanded_um[i], "gap")}`)),
      h("td", { class: "right" }, figure(length_um, "gap")),
      h("td", {}, t(isMeasured ? "map.measured" : "map.unmeasured"))))),
    h("caption", {}, t(isScattered ? "map.table_places" : "map.table_note", { k: COVERAGE })));
}
