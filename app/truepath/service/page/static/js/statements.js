/* Statements that the service makes in English, in the language of the page. */
import { nameOf } from "./tables.js";
import { currentLanguage, known, number, t } from "./texts.js";

/** What data do not determine: its beginning, and what would, by key. */
const UNOBSERVABLE = {
  merged: /^(?<symbol>E[XYZABC]{2}) \(.*?\) (?:is not distinguishable|cannot be told) from (?<others>.+?) with /,
  still: /^(?<symbol>E[XYZABC]{2}) \(.*?\) does not move the target/,
  undirected: /^lost motion: the result does not state what the direction of travel does/,
  resting: /^(?<axes>[A-Z, ]+): rotary axes stand still on this path/,
  unseen: /^(?<symbols>[\w, ]+): (?:\d+ common shapes are|a common shape is) not seen at the measured places/,
};
const REMEDIES = {
  by_tool: /at least (\d+) mm longer or shorter/, by_side: /at least (\d+) mm to the side/,
  by_other_tool: /tool longer or shorter/, by_other_side: /target to the side/, by_another: /another tool length or offset/,
  on_workpiece: /targets on the workpiece/, off_line: /off one line with these/,
  by_lines: /lines or points (?:determine|tell) too little/, by_standstill: /between standstills/, by_more_lines: /not corner to corner/,
};
const PRECISION = /\(to ([\d.]+) µrad, k = 2, on the same path\)/;
const NUMBER = "−?[\\d.]+";
const MOVED = new RegExp(`^(?:(.+): )?from (${NUMBER}) to (${NUMBER}) ± (${NUMBER}) (.+)$`);
const STATED = new RegExp(`^(.+?) (${NUMBER}) ± (${NUMBER}) ?(.*)$`);
const ALONE = new RegExp(`^(${NUMBER}) ± (${NUMBER}) ?(.*)$`);
const AT = /^(\S+) at (\S+) (\S+) (\S+)$/;
const UNIT = /_(um|urad|rad|mm_s|mm|deg|ms|hz|s|ppm)(_per_\w+)?$/;
const MANY = /^(\d+) parameters$/;
/** What the service says of calibrations that do not tell how a machine depends on its temperature, by key. */
const TEMPERATURE_REFUSALS = {
  few: /^(?<count>\d+) results: a line in temperature needs three/,
  targets: /^(?<one>.+) holds for other targets than (?<other>.+), or another tool/,
  shared: /^(?<one>.+) and (?<other>.+) share a Run/,
  close: /^the results are at (?<count>\d+) different temperatures \((?<shown>.+) °C; less than (?<apart>[\d.]+) K apart/,
  vague: /^temperatures from (?<low>[\d.−-]+) to (?<high>[\d.−-]+) °C tell .+ to (?<u>[\d.]+) µm\/K only .+ the (?<matters>[\d.]+) µm\/K that matter/,
};
const UNSTATED = /^(\S+): the result does not state where it was measured/;
const UNMEASURED = /^(\S+) not measured from (.+) mm: /;

/** What data do not determine, and what would; a statement of another form stands as it is. */
export function sayUnobservable(text) {
  const [key, found] = match(UNOBSERVABLE, text);
  if (currentLanguage() === "en" || !found) return text;
  const { symbol, symbols, others = "", axes } = found.groups;
  const said = t(`unobservable.${key}`, { symbol, symbols, axes, name: symbol && nameOf(symbol), others: others.replaceAll(" and ", ` ${t("statement.and")} `) });
  const [cure, remedy] = match(REMEDIES, text);
  const precision = PRECISION.exec(text);
  return [said, remedy && t(`unobservable.${cure}`, { length: number(remedy[1]) }),
    precision && t("unobservable.precision", { value: local(precision[1]) })].filter(Boolean).join(" ");
}

/** The first pattern that is in a text, by its key: [key, match]; null where none is. */
function match(patterns, text) {
  for (const [key, pattern] of Object.entries(patterns)) {
    const found = pattern.exec(text);
    if (found) return [key, found];
  }
  return [null, null];
}

/** Where an axis was not measured, and the choice (hold, fade) of what its table has there. */
export function sayUnmeasured(text, choice) {
  if (currentLanguage() === "en") return text;
  const unstated = UNSTATED.exec(text);
  if (unstated) return t("export.range_unstated", { axis: unstated[1] });
  const found = UNMEASURED.exec(text);
  if (!found) return text;
  const parts = found[2].split(" and ").map((part) => {
    const [from, to] = part.split(" to ").map((end) => number(end, (end.split(".")[1] ?? "").length));
    return t("statement.from_to", { from, to });
  });
  return t("export.axis_unmeasured", { axis: found[1], parts: parts.join(` ${t("statement.and")} `), choice: t(`export.unmeasured_${choice}`) });
}

/** A difference of two versions of a model without the name of what differs; null where its form is unknown. */
export function sayDifference(text) {
  const moved = MOVED.exec(text);
  if (moved) {
    const [, what, before, value, half, unit] = moved;
    return (what ? `${placed(what)}: ` : "") + t("model.moved", { before: local(before), now: withU(value, half, unit) });
  }
  const said = text.split(", ").map((part) => {
    const many = MANY.exec(part);
    if (many) return t("model.parameters", { count: number(many[1]) });
    const alone = ALONE.exec(part);
    if (alone) return withU(...alone.slice(1));
    const stated = STATED.exec(part);
    return stated && `${parameter(stated[1])} ${withU(...stated.slice(2))}`;
  });
  return said.every(Boolean) ? said.join(", ") : null;
}

const parameter = (stem) => {
  const [, name, way = ""] = /^(.*?)( [+−-])?$/.exec(stem);
  return known(`parameter.${name.replaceAll(" ", "_").replace(UNIT, "")}`, name) + way;
};

/** "EXX at X 250 mm", or the name of a parameter. */
function placed(what) {
  const found = AT.exec(what);
  if (!found) return parameter(what);
  const [, symbol, axis, position, unit] = found;
  return t("model.at", { symbol, axis, position: local(position), unit });
}

/** A number of the service as the language writes it. */
const local = (text) => number(text.replace("−", "-"), (text.split(".")[1] ?? "").length);

const withU = (value, half, unit) => `${local(value)} ± ${local(half)} ${unit}`.trim();

/** Why the temperatures of calibrations do not tell; null where the service's sentence has to stand. */
export function sayTemperatureRefusal(text) {
  if (currentLanguage() === "en") return null;
  for (const [key, pattern] of Object.entries(TEMPERATURE_REFUSALS)) {
    const found = pattern.exec(text);
    if (found) return t(`dependence.refused_${key}`, Object.fromEntries(Object.entries(found.groups).map(([name, value]) => [name, localAll(value)])));
  }
  return null;
}

/** Numbers, several of them apart by semicolons; names as they are. */
const localAll = (text) => (/^[\d.,\s−-]+$/.test(text) ? text.split(", ").map(local).join("; ") : text);
