/* The colours of lengths: from 0 to a round number, the same in volume, slice and key. */
import { h } from "../dom.js";
import { number, t } from "../texts.js";
import { shown, unitOf } from "../units.js";
import { colour } from "./css-colour.js";
import { roundReach } from "./error-chart.js";

const STOPS = ["map-low", "map-middle", "map-high"];

/** A scale that reaches over lengths in µm: {top_um, plotly, of(length_um)}. */
export function lengthScale(lengths_um) {
  const top = roundReach(shown(Math.max(...lengths_um, 1e-3), "error"));
  const top_um = top / shown(1, "error");
  const stops = STOPS.map(colour);
  return {
    top_um,
    plotly: stops.map((stop, i) => [i / (stops.length - 1), stop]),
    of: (length_um) => mix(stops, Math.min(1, length_um / top_um)),
  };
}

/** The colour at a share of a range, between evenly spread stops. */
export function mix(stops, share) {
  const at = share * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2);
  const [from, to] = [stops[i], stops[i + 1]].map(channels);
  return `rgb(${from.map((v, k) => Math.round(v + (at - i) * (to[k] - v))).join(" ")})`;
}

const channels = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));

/** The key of a scale: a bar with numbers and the unit. */
export function scaleKey({ top_um }) {
  const top = shown(top_um, "error");
  const digits = top >= 4 ? 0 : top >= 0.4 ? 1 : 2;
  const marks = [0, 0.5, 1].map((share) => h("span", {}, number(share * top, share === 0.5 && top < 10 ? Math.max(1, digits) : digits)));
  return h("div", { class: "scale-key" }, h("span", { class: "scale-name" }, t("map.length"), h("span", { class: "unit" }, unitOf("error"))),
    h("div", { class: "scale-bar", "aria-hidden": "true" }), h("div", { class: "scale-marks" }, marks));
}
