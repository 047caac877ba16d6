/* Step 6: what the model lacks, why, what to do about it, and how far the gap has closed. */
import { links } from "../api.js";
import { h, icon } from "../dom.js";
import { isDiscovery } from "../flow.js";
import { card, head, linkButton, notice, pairs } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { known, number, t } from "../texts.js";
import { quantity } from "../units.js";
import { extraCard, extraLead } from "./extra-card.js";

const UNITS = {
  um_per_m_K: "µm/m/K", um_per_m: "µm/m", um_per_s: "µm/s",
  urad: "µrad", rad: "rad", um: "µm", mm: "mm", ms: "ms", hz: "Hz", s: "s",
};

/** Button that leads on. */
export function lead(state, { actions, go }) {
  const { job } = state;
  if (!job) return { next: null };
  const back = isDiscovery(job) ? { label: t("discover.to_run"), run: () => go(`#/run/${job.id}`) }
    : { label: t("discover.to_result"), run: () => go(`#/result/${job.id}`) };
  const next = { key: "measure", label: t("discover.next"), run: () => go("#/connect") };
  return { next, back, ...extraLead(state, actions) };
}

/** Show what was found; before that, the button that asks for it. */
export function mount(root, { actions }) {
  let drawn = null;
  root.append(head(t("discover.title"), t("discover.text")));
  const body = h("div", { class: "stack" });
  root.append(body);
  return {
    update({ job, discovery }) {
      const shown = job && isDiscovery(job) ? discovery ?? "loading" : job?.id;
      if (!job || shown === drawn) return;
      drawn = shown;
      if (!isDiscovery(job)) body.replaceChildren(...[askCard(job, actions)].filter(Boolean));
      else if (discovery) body.replaceChildren(...found(job, discovery));
      else body.replaceChildren(h("p", { class: "empty" }, t("discover.loading")));
    },
    close() {},
  };
}

/** The button that asks what the model of a Run lacks; null where there is no Run. */
export function askCard(job, actions) {
  if (!job.run_id) return null;
  return card(t("discover.title"), h("p", { class: "quiet" }, t("discover.text")),
    h("div", {}, h("button", { class: "button", type: "button", onclick: () => actions.discover(job.run_id) },
      icon("check"), h("span", {}, t("discover.ask")))));
}

function found(job, { effects, unnamed, gap, ask }) {
  const cards = effects.length || unnamed.length ? effects.map(effectCard)
    : [notice(null, t("discover.none"), t("discover.none_text"))];
  return [downloads(job), gapCard(gap), extraCard(ask), ...cards, unnamedCard(unnamed)].filter(Boolean);
}

function downloads({ id }) {
  return h("div", { class: "downloads", role: "group" },
    linkButton(links.discoveryReport(id), "report", t("discover.report"), { target: "_blank", rel: "noopener" }),
    linkButton(links.model(id), "download", t("discover.model"), { download: "model.json" }));
}

function gapCard(gap) {
  const highest = 1.1 * Math.max(gap.before, gap.after, gap.noise_floor);
  const [before, after, floor] = [gap.before, gap.after, gap.noise_floor].map(micrometres);
  const bar = (name, value, shown, kind) => {
    const inside = h("i", { class: kind });
    inside.style.width = `${(100 * value) / highest}%`;
    return [h("dt", {}, name), h("dd", {}, inside, h("span", {}, shown))];
  };
  const mark = h("div", { class: "gap-floor", "aria-hidden": "true" });
  mark.style.setProperty("--at", String(gap.noise_floor / highest));
  return card(t("discover.gap"),
    h("div", { class: "gap" }, h("dl", {}, bar(t("discover.before"), gap.before, before, "is-before"),
      bar(t("discover.after"), gap.after, after, "is-after")), mark),
    h("p", { class: "gap-key" }, t("discover.floor", { value: floor })),
    h("p", { class: "quiet" }, t("discover.gap_text", { before, after, floor })));
}

function effectCard(effect) {
  const others = effect.indistinguishable_from.map(nameOf).join("; ") || t("discover.alone");
  const share = number(100 * effect.evidence.share_of_gap, 0);
  const content = card(nameOf(effect),
    h("p", { class: "finding-numbers" }, numbersOf(effect.parameters).join("; "), " ",
      h("small", {}, t("discover.k", { k: COVERAGE }))),
    pairs([[t("discover.cause"), effect.cause], [t("discover.looks_like"), effect.looks_like],
      [t("discover.remedy"), effect.remedy], [t("discover.evidence"), t("discover.share", { share })],
      [t("discover.others"), others]]));
  content.dataset.effect = effect.name;
  return content;
}

function unnamedCard(unnamed) {
  if (!unnamed.length) return null;
  const text = ({ description }) => description[0].toUpperCase() + description.slice(1);
  return card(t("discover.unnamed"),
    h("ul", { class: "lines" }, unnamed.map((one) => h("li", {}, text(one)))));
}

/** Name and keys of an effect: "Backlash Y". */
function nameOf({ name, axis, motion, by, direction, circle, symbol }) {
  const where = motion ?? symbol ?? [axis, by, direction, circle].filter(Boolean).join(" / ");
  return `${known(`effect.${name}`, name)} ${where}`.trim();
}

/** Parameters with expanded uncertainties: ["width 6.39 ± 0.15 µm"]. */
function numbersOf(parameters) {
  return Object.entries(parameters).map(([key, { value, uncertainty }]) => {
    const unit = Object.keys(UNITS).find((suffix) => key.endsWith(`_${suffix}`)) ?? "";
    const name = key.slice(0, key.length - (unit ? unit.length + 1 : 0)).replaceAll("_", " ");
    const all = [value].flat().map((v, i) => withU(v, [uncertainty].flat()[i]));
    return `${name} ${all.join(", ")} ${UNITS[unit] ?? ""}`.trim();
  });
}

/** Two digits of the expanded uncertainty. */
function withU(value, standard) {
  const half = COVERAGE * standard;
  const digits = half > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(half)), 0), 4) : 1;
  return `${number(value, digits)} ± ${number(half, digits)}`;
}

const micrometres = (value) => quantity(value, "gap");
