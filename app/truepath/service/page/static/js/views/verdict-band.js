/* What a result says of itself: loud where it is not simply usable. */
import { h, icon } from "../dom.js";
import { notice } from "../parts.js";
import { known, named, number, t } from "../texts.js";
import { quantity } from "../units.js";

const STATES = ["usable", "doubtful", "not-usable"];

const LARGE_UM = 10_000;

/** A number in the service's words: that of "+0.12 mm". */
const FIGURE = /\d+\.\d+(?= mm|°)/g;

/** Values of a reason by the last word of their name, which is their unit. */
const SHOWN = {
  s: (value) => `${number(value, 1)} s`,
  um: (value) => (value < LARGE_UM ? quantity(value, "error") : quantity(value / 1000, "length")),
  mm: (value) => quantity(value, "length"),
  urad: (value) => quantity(value, "angle"),
  percent: (value) => `${number(value, 1)} %`,
  ratio: (value) => number(value, 2),
};

/** Numbers of rows, and of the lines that lead to them: the service counts them from 0, people from 1. */
const COUNTED = new Set(["line", "lines", "points", "rows", "first", "last"]);

function shown(name, value) {
  if (COUNTED.has(name)) return String(value).replace(/\d+/g, (row) => number(Number(row) + 1));
  if (typeof value === "string") return value.replace(FIGURE, (figure) => number(Number(figure), figure.split(".")[1].length));
  const show = SHOWN[name.split("_").at(-1)];
  return show ? show(value) : number(value, Number.isInteger(value) ? 0 : 2);
}

/** A reason in the language of the page; in the service's words where it is of a kind unknown here. */
function sentence({ kind, run, values, remedy }, said) {
  const texts = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, shown(name, value)]));
  if (values.why_kind) texts.why = known(`verdict.why.${values.why_kind}`, values.why);
  const own = known(`verdict.${kind}`, null, texts);
  if (own === null) return [said, remedy];
  return [run ? `${t("verdict.run", { run: named(run) })} ${own}` : own, known(`verdict.${kind}_remedy`, remedy)];
}

/** The band above a result; null where there is nothing to know. */
export function verdictBand(verdict) {
  if (!verdict || (verdict.state === "usable" && !verdict.reasons.length)) return null;
  const { state, reasons, details = [] } = verdict;
  const lines = reasons.map((said, i) => {
    const detail = details[i] ?? { kind: "", state, values: {}, remedy: "" };
    const [text, remedy] = sentence(detail, said);
    return { rank: STATES.indexOf(detail.state), text, remedy };
  });
  lines.sort((a, b) => b.rank - a.rank);
  const told = new Set();  // what to do is said once
  const list = h("ul", {}, lines.map(({ rank, text, remedy }) => {
    const more = remedy && !told.has(remedy) && h("span", {}, ` ${remedy}`);
    told.add(remedy);
    return h("li", { class: rank > 0 ? "is-grave" : null }, text, more);
  }));
  return h("section", { class: "verdict-band", "data-verdict": state, role: state === "usable" ? "note" : "alert" },
    icon(state === "usable" ? "info" : "warning"),
    h("div", {}, h("h2", {}, t(`verdict.${state}`)), h("p", {}, t(`verdict.${state}_means`)), list));
}

/** That a result may be used. */
export const usableMark = () => h("span", { class: "verdict-mark", "data-verdict": "usable" },
  icon("check"), t("verdict.usable_mark"));

/** The state of a job's result in a word; null where the result is simply usable. */
export function verdictMark({ verdict }) {
  if (!verdict || verdict === "usable") return null;
  return h("span", { class: "verdict-mark", "data-verdict": verdict }, icon("warning"), t(`verdict.${verdict}`));
}

/** What a measurement under way says of itself: loud where its numbers do not count; null where it says nothing. */
export function liveVerdict(verdict) {
  const { state = "usable", reasons = [], details = [] } = verdict ?? {};
  const isLoud = state !== "usable";
  const texts = details.map((detail, i) => ({ grave: detail.state !== "usable", text: sentence(detail, reasons[i])[0] }))
    .filter(({ grave }) => grave === isLoud).map(({ text }) => text);
  if (isLoud) return notice(state === "doubtful" ? "held" : "fault", t(`verdict.live_${state}`), texts.join(" "));
  if (!texts.length) return null;
  const more = texts.length > 1 ? ` ${t("verdict.live_more", { count: number(texts.length - 1) })}` : "";
  return h("p", { class: "quiet" }, texts.at(-1) + more);
}

/** The same as a notice on the run that has ended. */
export function verdictNotice({ verdict }) {
  if (!verdict || verdict === "usable") return null;
  return notice(verdict === "doubtful" ? "held" : "fault", t(`verdict.${verdict}`),
    t(`verdict.${verdict}_means`), t("verdict.see_result"));
}
