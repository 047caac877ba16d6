/* Pieces that several views share. */
import { locate } from "./api.js";
import { h, icon, mark } from "./dom.js";
import { hasEnded } from "./flow.js";
import { COVERAGE } from "./plots/error-chart.js";
import { recall, retain } from "./preferences.js";
import { wordProblem } from "./problems.js";
import { known, number, t } from "./texts.js";
import { quantity } from "./units.js";

/** Heading of a view. */
export const head = (title, text) =>
  h("div", { class: "view-head" }, h("div", {}, h("h1", {}, title), text && h("p", {}, text)));

/** A card with a heading. */
export const card = (title, ...content) =>
  h("section", { class: "card" }, title && h("h2", {}, title), content);

/** A card of one line that opens on a tap, and stays so in this tab; `value` says in a word what is chosen inside. */
export function fold(name, title, ...content) {
  const value = h("span", { class: "quiet" });
  const element = h("details", { class: "card fold", "data-fold": name, open: recall("folds", {})[name] ?? false,
    ontoggle: () => retain("folds", { ...recall("folds", {}), [name]: element.open }) }, h("summary", {}, h("h2", {}, title), " ", value), content);
  return { element, value };
}

/** Room for a table that may be wider than its card; arrow keys scroll it. */
export const tableFrame = (label, ...content) =>
  h("div", { class: "table-scroll", tabindex: "0", role: "region", "aria-label": label }, content);

/** Name and value in rows: pairs([[name, value], …]). */
export const pairs = (rows) =>
  h("dl", { class: "pairs" }, rows.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));

/** Bars on one scale, the longest `highest`: bars([[name, value, text, class], …], highest). */
export const bars = (rows, highest) => h("div", { class: "gap" }, h("dl", {}, rows.map(([name, value, text, kind]) => {
  const inside = h("i", { class: kind });
  inside.style.width = `${(100 * value) / highest}%`;
  return [h("dt", {}, name), h("dd", {}, inside, h("span", {}, text))];
})));

/** One number with its name; `write(value)` changes it. */
export function tile(name, value = "–") {
  const number = h("dd", {}, value);
  const element = h("div", { class: "tile" }, h("dt", {}, name), number);
  return { element, number };
}

/** What may no longer hold stays readable: hatched, with its age; `age_s` null where it is current. */
export function markStale(element, age_s) {
  element.classList.toggle("is-stale-data", age_s !== null);
  mark(element, "data-age", age_s === null ? null : t("run.age", { age: age_s }));
}

/** A choice among few, all visible: segments(label, [[value, text], …], chosen, choose). */
export function segments(label, options, chosen, choose, small = false) {
  const group = h("div", { class: `segments${small ? " is-small" : ""}`, role: "group", "aria-label": label });
  const buttons = options.map(([value, text]) =>
    h("button", { "aria-pressed": String(value === chosen), "data-value": value,
      onclick: () => {
        for (const b of buttons) b.setAttribute("aria-pressed", String(b.dataset.value === value));
        choose(value);
      } }, text));
  group.append(...buttons);
  return group;
}

/** What the service says of a compensation format, in the page's language where there are words for it. */
export const wordFormat = (name, what, text) => known(`format.${name}.${what}`, text);

/** A message with a shape, a word and a way out. */
export function notice(tone, title, text, action) {
  const shape = tone === "fault" || tone === "held" ? "warning" : "info";
  return h("div", { class: `notice${tone ? ` is-${tone}` : ""}` }, icon(shape),
    h("div", {}, h("strong", {}, title), text && h("p", {}, text), action && h("p", {}, action)));
}

const TONES = {
  "awaiting-move": "held",
  pausing: "held", paused: "held", aborting: "held", cancelling: "held", resuming: "held",
  failed: "fault", faulted: "fault", aborted: "fault", interrupted: "fault",
};
const SHAPES = {
  running: "play", pausing: "pause", paused: "pause", resuming: "play", succeeded: "check",
  ready: "hold", "awaiting-move": "hold", aborting: "stop", cancelling: "hold", cancelled: "hold", aborted: "stop", failed: "warning", faulted: "warning",
  interrupted: "warning",
};

/** Tone of a state: held (will go on), fault (needs a person) or none. */
export const toneOf = (state) => TONES[state] ?? null;

/** Shape that goes with a state. */
export const shapeOf = (state) => SHAPES[state] ?? "info";

/** Word for a state. */
export const wordOf = (state) => known(`state.${state}`, state);

/** Word for a kind of job. */
export const kindOf = (kind) => known(`kind.${kind}`, kind);

/** A link that looks like a button. */
export const linkButton = (address, shape, text, more = {}) =>
  h("a", { class: "button", href: locate(address), ...more }, icon(shape), text);

/** Everything a problem says, as a notice. */
export function problemNotice(problem, tone = "fault") {
  const { title, text, action } = wordProblem(problem);
  return notice(tone, title, text, action);
}

/** Everything a job's error says, as a notice; null where it has none. */
export const errorNotice = (job, tone) => (job.error ? problemNotice(job.error, tone) : null);

/** Why a measurement left out the rest of its plan, as a notice; null if it did not. */
export function earlyEndNotice(job) {
  if (!job.early_end) return null;
  const { reached_um, done, total } = job.early_end;
  const expanded = (um) => quantity(COVERAGE * um, "error");
  const values = {
    reached: expanded(reached_um), target: expanded(job.target_um), k: COVERAGE,
    done: number(done), total: number(total),
    unit: t(job.kind === "measure-standstill" ? "unit.points" : "unit.lines"),
  };
  const over = hasEnded(job) ? t("early.over") : t("early.under_way");
  return notice(null, t("early.title"), t("early.text", values), over);
}
