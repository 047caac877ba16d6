/* Step 3: what will move, and the hold that starts it. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { addressOf, hasEnded, isExtra, rowsNow, stepOf, waitsForArming } from "../flow.js";
import { term } from "../glossary.js";
import { nameOfBox } from "../keep-out.js";
import { card, errorNotice, fold, head, kindOf, linkButton, notice, pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { duration, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { adviceCard, placeText } from "./advice-card.js";
import { armingCard } from "./arming-card.js";
import { conditionsCard, obstacle, wordsOf } from "./conditions-card.js";
import { plannedGrade } from "./grade-card.js";
import { pathCard } from "./path-card.js";
import { again } from "./run.js";

const SAFETY_TEXTS = ["check.before_clear", "check.before_reflector", "check.before_sight"];
const STATION_REASONS = {
  "not-moved": "station.not-moved", "not-seen": "station.not-seen", residual: "station.residual",
  moved: "station.moved",
};

/** Button that leads on: held, because the machine moves. */
export function lead(state, { actions, go }) {
  const { job, plan } = state;
  if (!job || hasEnded(job)) return { next: again(job, plan, go) };
  if (stepOf(job) !== "check") {
    return { next: { key: "show", label: t("connect.show_job"), run: () => go(addressOf(job)) } };
  }
  const reason = refusal(state);
  const back = { label: t("check.discard"), run: () => discard(actions, again(job, plan, go)) };
  return { back, reason: reason || t("check.hold_reason"),
    next: { key: "arm", label: t("check.hold"), icon: "hold", hold: true,
      disabled: Boolean(reason), begin: actions.beginHold, run: actions.arm } };
}

function refusal({ job, link, asked, conditions, safetyRead }) {
  if (asked) return t("check.asked");
  if (!waitsForArming(job)) return t("check.preparing");
  if (link.stale) return t("check.stale");
  const first = obstacle(conditions);
  if (first) return wordsOf(first);
  return isSafetyRead(safetyRead, job) ? "" : t("check.read_first");
}

async function discard(actions, { run }) {
  await actions.abort();
  run();
}

/** Show the plan. */
export function mount(root, { store, actions }) {
  const conditions = conditionsCard(store);
  const path = pathCard(false);
  const grade = plannedGrade();
  const program = programCard();
  const facts = fold("run", t("check.plan"), h("div"));
  const safety = safetyCard(store);
  const arming = armingCard(store, actions);
  const failure = h("div", { class: "stack below" });
  const advice = h("div", { class: "stack" });
  root.append(
    head(t("check.title"), t("check.text")), safety.element, failure,
    h("div", { class: "columns is-check" },
      h("div", { class: "stack" }, path.element, h("div", { class: "folds" }, fold("grade", t("grade.title"), grade.element).element, fold("program", t("program.title"), program.element).element)),
      h("div", { class: "stack" }, arming.element, facts.element, advice), conditions.element),
  );
  let described = "";
  return {
    update(state) {
      const { job, plan: whole, machine } = state;
      conditions.update(state);
      safety.update(job);
      arming.update(job);
      const plan = rowsNow(whole, job);
      path.update(plan && { ...plan, tracker_mm: plan.position_mm ?? plan.tracker_mm }, machine);
      if (!isExtra(job) && !whole?.stations) grade.update(job, plan);
      program.update(job, plan);
      const key = [job?.id, job?.version, Boolean(plan)].join();
      if (key === described || !job) return;
      described = key;
      facts.element.lastElementChild.replaceWith(pairs(describe(job, plan)));
      advice.replaceChildren(...[adviceCard(plan)].filter(Boolean));
      failure.replaceChildren(...[errorNotice(job), ...stationNotices(job)].filter(Boolean));
    },
    close() {
      path.close();
      conditions.close();
      safety.close();
      arming.close();
    },
  };
}

function describe(job, plan) {
  const facts = [[t("check.kind"), kindOf(job.kind)]];
  if (!plan) return facts;
  const standing = !plan.feed_mm_min?.length;
  const length = lengthOf(plan);
  facts.push([t(standing ? "check.points" : "check.lines"),
    number(plan.position.length - (standing ? 0 : 1))]);
  facts.push([t("check.length"), quantity(length, "distance")]);
  if (job.target_um) {
    const target = quantity(COVERAGE * job.target_um, "error");
    facts.push([t("check.target"), t("check.target_at", { target, k: COVERAGE })]);
  }
  if (plan.predicted_um) {
    const predicted = quantity(COVERAGE * plan.predicted_um, "error");
    facts.push([term("uncertainty", t("check.predicted")), t("check.predicted_at", { predicted, k: COVERAGE })]);
  }
  if (plan.keep_out) facts.push([t("keepout.title"), plan.keep_out.map(nameOfBox).join("; ") || t("keepout.none")]);
  const time_s = job.progress?.eta_s ?? plan.duration_s;
  if (time_s) facts.push([t("check.time"), `${duration(time_s)} min`]);
  return facts;
}

function lengthOf({ axes, position }) {
  const linear = axes.map((name, i) => ("XYZ".includes(name) ? i : -1)).filter((i) => i >= 0);
  return position.slice(1).reduce((sum, row, i) =>
    sum + Math.hypot(...linear.map((a) => row[a] - position[i][a])), 0);
}

/** What a person has to do with the tracker before the job is armed, as notices. */
function stationNotices(job) {
  const { station } = job;
  if (!station || !waitsForArming(job)) return [];
  const check = station.checks.find((one) => one.station === station.number);
  const place = placeText(station.position_mm);
  const values = { number: number(station.number), total: number(station.total), place };
  const asked = notice("held", t("station.title", values), t("station.text", values), t("station.action"));
  return check?.problem ? [refused(check), asked] : [asked];
}

function refused({ problem, text }) {
  return notice("fault", t(STATION_REASONS[problem]), text, t("station.again"));
}

/** A card with a download a control, there as soon as the job has a plan. */
function programCard() {
  const downloads = h("div", { class: "downloads", role: "group", "aria-label": t("program.title") });
  const element = card(t("program.title"), h("p", {}, t("program.text")), downloads);
  element.hidden = true;
  let offered = "";

  async function offer(id) {
    const controls = await api.dialects();
    downloads.replaceChildren(...controls.map(({ name, control }) =>
      linkButton(api.links.program(id, name), "download", control, { download: "" })));
    element.hidden = false;
  }

  return {
    element,
    update(job, plan) {
      if (!job || !plan || offered === job.id) return;
      offered = job.id;
      // Without the list there is no card: the path can be driven all the same.
      offer(job.id).catch(() => { element.hidden = true; });
    },
  };
}

/** Whether each sentence has been in sight since the job asks to be armed. */
const isSafetyRead = (read, job) => Boolean(read) && read.key === readKey(job) && read.count === SAFETY_TEXTS.length;

/** Armed once more, as after the tracker was moved, it is to be read once more. */
const readKey = (job) => `${job.id}:${job.station?.number ?? 1}:${job.state}`;

/** Card with the sentences; keeps `safetyRead` of the store; `close` ends the watching. */
function safetyCard(store) {
  const items = SAFETY_TEXTS.map((key) => h("li", {}, icon("warning"), t(key)));
  const seen = new Set();
  const style = getComputedStyle(document.documentElement);
  const [top, bottom] = ["--bar", "--footer"].map((name) => Number.parseFloat(style.getPropertyValue(name)));
  // What lies under the bar or behind the button is not in sight.
  const watcher = new IntersectionObserver(note, { threshold: 0.99, rootMargin: `-${top}px 0px -${bottom}px 0px` });
  let key = "";

  function note(entries) {
    for (const { isIntersecting, target } of entries) if (isIntersecting) seen.add(target);
    store.set({ safetyRead: { key, count: seen.size } });
  }

  return {
    element: h("div", { class: "safety below" }, card(t("check.before"), h("ul", { class: "before" }, items))),
    update(job) {
      if (!job || readKey(job) === key) return;
      key = readKey(job);
      seen.clear();
      watcher.disconnect();
      for (const item of items) watcher.observe(item); // tells at once what is in sight already
    },
    close: () => watcher.disconnect(),
  };
}
