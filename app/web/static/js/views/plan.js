/* Step 2: how to measure. */
import { h, mark } from "../dom.js";
import { addressOf, isActive, isConnected } from "../flow.js";
import { head } from "../parts.js";
import { number, plain, t } from "../texts.js";
import { decimalsOf, shown, stored, unitOf } from "../units.js";

const FEED_MM_MIN = { usual: 6000, least: 100, most: 20000, step: 500 };
const choices = { kind: "measure-otf", feed_mm_min: FEED_MM_MIN.usual, perpendicular_only: false };

/** Whether the machine moves while it is measured: only then there is a feed to choose. */
const streams = () => choices.kind === "measure-otf";

const withinLimits = (feed) => feed >= FEED_MM_MIN.least && feed <= FEED_MM_MIN.most;

/** Button that leads on. */
export function lead({ machine, busy, job }, { actions, go }) {
  const back = { label: t("shell.back"), run: () => go("#/connect") };
  if (isActive(job)) {
    return { back, reason: t("plan.busy"),
      next: { key: "show", label: t("connect.show_job"), run: () => go(addressOf(job)) } };
  }
  const reason = refusal(machine, busy);
  return { back, reason,
    next: { key: "prepare", label: t("plan.next"), disabled: Boolean(reason),
      run: () => actions.prepare(order()) } };
}

function refusal(machine, busy) {
  if (busy) return t("plan.preparing");
  if (!isConnected(machine)) return t("plan.not_connected");
  return !streams() || withinLimits(choices.feed_mm_min) ? "" : t("plan.feed_refused");
}

function order() {
  const { kind, feed_mm_min, perpendicular_only } = choices;
  return { kind, perpendicular_only, ...(streams() ? { feed_mm_min } : {}) };
}

/** Show the choices. */
export function mount(root, { store }) {
  const changed = () => store.set({});
  const feed = feedField(changed);
  root.append(
    head(t("plan.title"), t("plan.text")),
    h("div", { class: "columns" },
      h("section", { class: "card stack" }, h("h2", {}, t("plan.how")), kinds(changed)),
      h("section", { class: "card stack" }, h("h2", {}, t("plan.details")),
        feed, perpendicular())),
  );
  return {
    update() {
      feed.hidden = !streams();
    },
    close() {},
  };
}

function kinds(changed) {
  const option = (kind) => h("button", { class: "choice", type: "button", role: "radio",
    "aria-checked": String(choices.kind === kind), "data-kind": kind,
    onclick: () => choose(kind) },
  h("strong", {}, t(`kind.${kind}`)), h("span", {}, t(`plan.${kind}`)));
  const options = ["measure-otf", "measure-standstill"].map(option);
  function choose(kind) {
    choices.kind = kind;
    for (const o of options) mark(o, "aria-checked", String(o.dataset.kind === kind));
    changed();
  }
  return h("div", { class: "stack", role: "radiogroup", "aria-label": t("plan.how") }, options);
}

function feedField(changed) {
  const input = h("input", { id: "feed", inputmode: "decimal", autocomplete: "off",
    "aria-describedby": "feed-note feed-error" });
  const error = h("p", { class: "field-error", id: "feed-error", role: "status" });
  const limits = { least: limit(FEED_MM_MIN.least), most: limit(FEED_MM_MIN.most), unit: unitOf("feed") };

  function show() {
    input.value = plain(shown(choices.feed_mm_min, "feed"), decimalsOf("feed"));
    check();
  }

  function check() {
    const good = withinLimits(choices.feed_mm_min);
    mark(input, "aria-invalid", good ? null : "true");
    error.textContent = good ? "" : t("plan.feed_limits", limits);
    changed();
  }

  function step(direction) {
    const from = Number.isFinite(choices.feed_mm_min) ? choices.feed_mm_min : FEED_MM_MIN.usual;
    const next = (Math.round(from / FEED_MM_MIN.step) + direction) * FEED_MM_MIN.step;
    choices.feed_mm_min = Math.min(FEED_MM_MIN.most, Math.max(FEED_MM_MIN.least, next));
    show();
  }

  input.addEventListener("input", () => {
    choices.feed_mm_min = stored(typed(input.value), "feed");
    check();
  });
  show();
  return h("div", { class: "field" }, h("label", { for: "feed" }, t("plan.feed")),
    h("div", { class: "stepper" },
      h("button", { class: "button", type: "button", "aria-label": t("plan.slower"), onclick: () => step(-1) }, "−"),
      input,
      h("button", { class: "button", type: "button", "aria-label": t("plan.faster"), onclick: () => step(1) }, "+"),
      h("span", { class: "suffix" }, unitOf("feed"))),
    h("p", { class: "field-note", id: "feed-note" }, t("plan.feed_note")), error);
}

const limit = (feed) => number(shown(feed, "feed"), 0);

/** A typed number; grouping and decimal sign as the language writes them. */
function typed(text) {
  const sign = number(1.5, 1)[1];
  const group = sign === "," ? /[.\s]/g : /[,\s]/g;
  const digits = text.replace(group, "").replace(sign, ".");
  return digits === "" ? NaN : Number(digits);
}

function perpendicular() {
  const box = h("button", { class: "choice is-box", type: "button", role: "checkbox",
    "aria-checked": String(choices.perpendicular_only),
    onclick: () => {
      choices.perpendicular_only = !choices.perpendicular_only;
      mark(box, "aria-checked", String(choices.perpendicular_only));
    } },
  h("strong", {}, t("plan.perpendicular")), h("span", {}, t("plan.perpendicular_note")));
  return box;
}
