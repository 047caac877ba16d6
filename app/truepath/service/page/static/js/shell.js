/* What surrounds the views: state and stamp in the bar, steps, problems, the next button. */
import { h, icon, mark, write } from "./dom.js";
import { GROUPS, hasEnded, isActive, isComputing, isConnected, isMeasuring, jobUnderWay, machineName, OPTIONAL, reach, resultId, STEPS } from "./flow.js";
import { holdToConfirm } from "./hold.js";
import { notice, shapeOf, toneOf, wordOf } from "./parts.js";
import { clock, t } from "./texts.js";

const element = (id) => document.getElementById(id);

/** Write machine, state and age of the data into the bar. */
export function updateBar(state) {
  const { system, machine, link } = state;
  const job = jobUnderWay(state);
  write(element("machine-name"), machineName(state));
  element("simulated").hidden = !system?.simulated;
  const { word, tone, shape } = situation(machine, job);
  const shown = element("state");
  if (shown.textContent !== word) shown.replaceChildren(icon(shape), word);
  mark(shown, "data-tone", tone);
  updateStamp(link);
  document.title = job && isActive(job) ? `${word} · Truepath` : "Truepath";
  // Abort reads this to know whose end it has to see.
  mark(document.body, "data-measuring", isActive(job) && isMeasuring(job) ? job.id : null);
}

function situation(machine, job) {
  if (job && (isActive(job) || toneOf(job.state) === "fault")) {
    const word = isActive(job) && isComputing(job) ? t("state.analysing") : wordOf(job.state);
    return { word, tone: toneOf(job.state), shape: shapeOf(job.state) };
  }
  const word = isConnected(machine) ? "state.connected" : "state.not_connected";
  return { word: t(word), tone: null, shape: isConnected(machine) ? "check" : "info" };
}

function updateStamp({ stale, asked, last }) {
  const stamp = element("stamp");
  stamp.classList.toggle("is-stale", stale);
  document.body.classList.toggle("is-stale", stale);
  const since = last ? clock(last) : "–";
  const word = asked ? "stamp.asked" : "stamp.live";
  const fresh = last ? t(word) : t("stamp.waiting");
  write(stamp, stale ? t("stamp.stale", { since }) : fresh);
}

/** Write the steps in their groups; those that can be reached are links. */
export function updateSteps(state, current) {
  const key = JSON.stringify([current, STEPS.map((step) => [reach(step, state), isDone(step, state, current)]), t("step.connect")]);
  const list = element("steps");
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...GROUPS.map((group) => groupEntry(group, state, current)));
  mark(element("to-records"), "aria-current", current === "records" ? "page" : null);
}

/** A group; its own name is seen where the panel is too narrow for all steps at once. */
function groupEntry({ name, steps }, state, current) {
  const isHere = steps.includes(current);
  const address = steps.map((step) => reach(step, state)).find(Boolean);
  const title = h(address && !isHere ? "a" : "span", { class: "group-name", href: isHere ? null : address }, t(`step.group.${name}`));
  return h("li", { class: "group", "data-here": isHere, "data-done": isPassed(steps.at(-1), current) }, title,
    h("ol", { "aria-label": t(`step.group.${name}`) }, steps.map((step) => stepEntry(step, state, current))));
}

const isPassed = (step, current) => STEPS.indexOf(step) < STEPS.indexOf(current);

/** What may be left out is ticked off once it was done, not by going past it. */
const isDone = (step, state, current) => (OPTIONAL.has(step) ? step !== current && Boolean(state.done[resultId(state)]?.[step]) : isPassed(step, current));

function stepEntry(step, state, current) {
  const done = isDone(step, state, current);
  const inside = [h("span", { class: "step-dot" }, done ? icon("check") : String(STEPS.indexOf(step) + 1)),
    h("span", { class: "step-name" }, t(`step.${step}`))];
  const address = reach(step, state);
  const here = step === current ? { "aria-current": "step" } : {};
  const entry = address ? h("a", { href: address, ...here }, inside) : h("span", here, inside);
  return h("li", { class: "step", "data-done": done }, entry);
}

/** Show what was refused, with the way out. */
export function updateProblems({ problem }, dismiss) {
  const place = element("problems");
  if (place.problem === problem) return;
  place.problem = problem;
  if (!problem) {
    place.replaceChildren();
    return;
  }
  const shown = notice(problem.tone, problem.title, problem.text, problem.action);
  const button = (label, run) => h("button", { class: "button", onclick: run }, label);
  const { offer } = problem;
  shown.append(h("div", { class: "problem-buttons" }, offer && button(offer.label, offer.run), button(t("shell.dismiss"), dismiss)));
  place.replaceChildren(shown);
  scrollTo({ top: 0 });
}

/** Show the button that leads on, why it cannot, the way back, and a quiet second choice. */
export function updateLead({ next, back, aside, reason = "" }, link, job) {
  write(element("reason"), reason);
  element("reason").classList.toggle("is-held", Boolean(link.stale && job && !hasEnded(job)));
  place(element("next"), next, nextButton);
  place(element("back"), back && { key: "back", ...back }, backButton);
  place(element("aside"), aside && { key: "aside", ...aside }, asideButton);
}

/** Keep the button while its meaning stays, else a press under way would be lost. */
function place(container, wanted, make) {
  const key = wanted ? `${wanted.key}:${wanted.label}` : "";
  if (container.dataset.key !== key) {
    container.dataset.key = key;
    container.replaceChildren(...(wanted ? [make(container)] : []));
  }
  container.wanted = wanted;
  const button = container.firstElementChild;
  if (button && button.disabled !== Boolean(wanted.disabled)) button.disabled = Boolean(wanted.disabled);

  function fresh() {
    return container.wanted.run();
  }
  if (button && !button.bound) {
    button.bound = true;
    if (wanted.hold) holdToConfirm(button, fresh, () => container.wanted.begin?.());
    else button.addEventListener("click", fresh);
    button.prepend(...(wanted.icon ? [icon(wanted.icon)] : []));
    button.append(h("span", {}, wanted.label));
    if (make === nextButton && !wanted.hold) button.append(icon("next"));
  }
}

const nextButton = () => h("button", { class: "next", "aria-describedby": "reason" });

const backButton = () => h("button", { class: "button is-plain" }, icon("back"));

const asideButton = () => h("button", { class: "button is-plain" });
