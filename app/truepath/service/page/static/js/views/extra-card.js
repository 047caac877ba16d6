/* What a discovery asks of the machine: which names compete, and the lines that decide. */
import { h } from "../dom.js";
import { isActive, isConnected, isMeasuring } from "../flow.js";
import { card, pairs } from "../parts.js";
import { duration, known, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { basedOrder, keepOutChoice, refuseBased } from "./keep-out-card.js";

const DECIDED = 12; // expected log Bayes factor

/** Button that has the extra lines driven, as soon as somebody arms them; null where none are asked for. */
export function extraLead(state, actions) {
  const { job, discovery } = state;
  if (!discovery?.ask) return null;
  const reason = refusal(state);
  return { reason, next: { key: "extra", label: t("extra.drive"), disabled: Boolean(reason),
    run: () => driveExtra(state, actions) } };
}

/** Prepare the extra lines; nothing moves yet. */
export const driveExtra = (state, actions) => actions.driveExtra(state.job, basedOrder(machineIdOf(state)));

const machineIdOf = ({ job, machine_id }) => job.machine ?? machine_id;

function refusal(state) {
  const { machine, jobs, busy } = state;
  if (busy) return t("plan.preparing");
  if (!isConnected(machine)) return t("extra.not_connected");
  return jobs.some((job) => isMeasuring(job) && isActive(job)) ? t("plan.busy") : refuseBased(machineIdOf(state));
}

/** Cards with the questions and the lines, and with what these keep clear of; none where nothing is asked. */
export function extraCards({ job, discovery: { ask }, machine, machine_id }, changed) {
  if (!ask) return [];
  const { questions, lines, duration_s, rows, decides } = ask;
  const element = card(t("extra.title"),
    h("ul", { class: "lines" }, questions.map((question) => h("li", {}, asked(question)))),
    h("p", {}, t("extra.text")),
    pairs([[t("check.lines"), number(lines)], [t("check.time"), `${duration(duration_s)} min`],
      [t("check.feed"), feeds(rows)],
      [t("extra.expected"), t("extra.factor", { least: number(least(questions), 0), decided: DECIDED })]]),
    h("p", { class: "quiet" }, t(decides ? "extra.decides" : "extra.falls_short")));
  element.dataset.ask = String(decides);
  return [element, keepOutChoice(machineIdOf({ job, machine_id }), machine, changed)];
}

const least = (questions) => Math.min(...questions.map((q) => q.expected_log_bayes));

function asked({ between: [one, other] }) {
  return other ? t("extra.alike", { one: worded(one), other: worded(other) }) : t("extra.thin", { one: worded(one) });
}

/** The label of an effect, its name in words: "servo-mismatch X" is "Servo mismatch X". */
function worded(label) {
  const [name, ...where] = label.split(" ");
  return [known(`effect.${name}`, name), ...where].join(" ");
}

function feeds(rows) {
  const all = [...new Set(rows.slice(1).map((row) => Math.round(row.feed_mm_min)))].sort((a, b) => a - b);
  return all.map((feed) => quantity(feed, "feed")).join(", ");
}
