/* Step 6: what the model lacks, why, what to do about it, and how far the gap has closed. */
import { effects, links } from "../api.js";
import { h, icon } from "../dom.js";
import { isDiscovery } from "../flow.js";
import { bars, card, head, linkButton, notice } from "../parts.js";
import { currentLanguage, known, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { extraCards, extraLead } from "./extra-card.js";
import { cannotTellCard, effectCard, structureCard } from "./finding-card.js";
import { closingCard, versionsCard } from "./model-card.js";
import { newMeasurement, onward } from "./onward.js";
import { stripsCard } from "./strips-card.js";
import { verdictBand } from "./verdict-band.js";

const MOST_SHARES = 6;

/** Button that leads on. */
export function lead(state, { actions, go }) {
  const { job } = state;
  if (!job) return { next: null };
  const next = onward("discover", state, go);
  const aside = newMeasurement(go);
  if (isDiscovery(job)) {
    const back = { label: t("discover.to_run"), run: () => go(`#/run/${job.id}`) };
    return { next, back, aside, ...extraLead(state, actions) };
  }
  const back = { label: t("discover.to_result"), run: () => go(`#/result/${job.id}`) };
  if (!job.run_id) return { next, back, aside };
  const ask = { key: "discover", label: t("discover.ask"), disabled: Boolean(state.busy),
    run: () => actions.discover(job.run_id) };
  return { next: ask, back, aside: { label: next.label, run: next.run } };
}

/** Show what was found; before that, what is going to be done. */
export function mount(root, { store, actions }) {
  let drawn = null;
  let closing = null;
  root.append(head(t("discover.title"), t("discover.text")));
  const body = h("div", { class: "stack" });
  root.append(body);
  return {
    update(state) {
      const { job, discovery } = state;
      closing?.update(state);
      const shown = job && isDiscovery(job) ? discovery ?? "loading" : job?.id;
      if (!job || shown === drawn) return;
      drawn = shown;
      closing = isDiscovery(job) && discovery ? closingCard(state, actions) : null;
      closing?.update(state);
      if (!isDiscovery(job)) body.replaceChildren(prospect(job));
      else if (discovery) body.replaceChildren(...found(state, extraCards(state, () => store.set({})), closing.element));
      else body.replaceChildren(h("p", { class: "empty" }, t("discover.loading")));
    },
    close() {},
  };
}

/** The button that asks what the model of a Run lacks; null where there is no Run. */
export function askCard(job, actions) {
  if (!job.run_id) return null;
  return card(t("discover.title"), h("p", { class: "quiet" }, t("discover.text")),
    h("div", {}, h("button", { class: "button", "data-needs": "operator", onclick: () => actions.discover(job.run_id) },
      icon("check"), h("span", {}, t("discover.ask")))));
}

/** What is going to happen, before it is asked for. */
function prospect(job) {
  if (!job.run_id) return notice(null, t("discover.no_run"));
  return card(null, h("p", {}, t("discover.how")), catalogue());
}

/** Every effect that is installed, asked for when it is opened. */
function catalogue() {
  const list = h("dl", {}, h("dt", {}, t("discover.catalogue_loading")));
  const details = h("details", {}, h("summary", {}, t("discover.catalogue")), list);
  details.addEventListener("toggle", async () => {
    const found = await effects(currentLanguage());
    list.replaceChildren(...found.flatMap((one) => [h("dt", {}, one.title),
      h("dd", {}, [one.looks_like, one.cause, one.enters_analyse ? "" : t("discover.ends_with_run")].join(" ").trim())]));
  }, { once: true });
  return details;
}

function found({ job, discovery }, extra, closing) {
  const { verdict, effects, possible = [], unnamed, cannot_tell: untold = [], gap, explained_by: explained, lines } = discovery;
  const cards = [...effects.map(effectCard), ...unnamed.map(structureCard), ...possible.map(effectCard)];
  const findings = cards.length ? cards : [notice(null, t("discover.none"), t("discover.none_text"))];
  return [verdictBand(verdict), downloads(job), ...findings, cannotTellCard(untold), gapCard(gap), ...extra, closing, stripsCard(lines), whereCard(explained),
    versionsCard(job.id)].filter(Boolean);
}

function downloads({ id, verdict }) {
  const file = verdict === "not-usable" ? "not-to-be-used-model.json" : "model.json";
  return h("div", { class: "downloads", role: "group", "aria-label": t("result.downloads") },
    linkButton(links.discoveryReport(id), "report", t("discover.report"), { target: "_blank", rel: "noopener" }),
    linkButton(links.model(id), "download", t("discover.model"), { download: file }));
}

function gapCard(gap) {
  const highest = 1.1 * Math.max(gap.before, gap.after, gap.noise_floor);
  const [before, after, floor] = [gap.before, gap.after, gap.noise_floor].map(micrometres);
  const shown = bars([[t("discover.before"), gap.before, before, "is-before"], [t("discover.after"), gap.after, after, "is-after"]], highest);
  const mark = h("div", { class: "gap-floor", "aria-hidden": "true" });
  mark.style.setProperty("--at", String(gap.noise_floor / highest));
  shown.append(mark);
  return card(t("discover.gap"), shown,
    h("p", { class: "gap-key" }, t("discover.floor", { value: floor })),
    h("p", { class: "quiet" }, [t("discover.gap_text", { before, after, floor }), complete(gap)].join(" ")));
}

/** Residual that is expected of a complete model. */
const complete = ({ expected }) =>
  (expected === undefined ? "" : t("discover.complete", { value: micrometres(expected) }));

const micrometres = (value) => quantity(value, "gap");

/** A card with a bar for each grouping; null where the discovery does not tell. */
function whereCard(explained) {
  if (!explained) return null;
  const { before, after } = explained;
  const rows = Object.entries(before).sort(([, a], [, b]) => b - a).slice(0, MOST_SHARES);
  const highest = Math.max(...rows.map(([name, share]) => Math.max(share, after[name] ?? 0)), 0.01);
  const bar = (share, kind) => {
    const inside = h("i", { class: kind });
    inside.style.width = `${(100 * share) / highest}%`;
    return inside;
  };
  const percent = (share) => number(100 * share, 0);
  const row = ([name, share]) => [h("dt", {}, wordGrouping(name)),
    h("dd", {}, h("div", { "aria-hidden": "true" }, bar(share, "is-before"), bar(after[name] ?? 0, "is-after")),
      h("span", {}, t("where.share", { before: percent(share), after: percent(after[name] ?? 0) })))];
  const element = card(t("where.title"), h("p", { class: "quiet" }, t("where.text")),
    h("dl", { class: "shares" }, rows.map(row)));
  element.dataset.where = "";
  return element;
}

/** A grouping in words: "position of X", "region of X and Y", "moving axis", "time". */
function wordGrouping(name) {
  const [group, of = ""] = name.split(" of ");
  const [one, other] = of.split(" and ");
  const key = `where.${group.split(" ")[0]}`;
  return known(key, "") ? t(key, { of: known(`sensor.${of}`, of), one, other }) : name;
}
