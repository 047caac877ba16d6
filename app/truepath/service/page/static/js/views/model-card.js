/* What to do with the model of a discovery, and how it grew. */
import * as api from "../api.js";
import { h, icon } from "../dom.js";
import { modelInUse, useModel } from "../model-choice.js";
import { card, linkButton, notice } from "../parts.js";
import { sayDifference } from "../statements.js";
import { currentLanguage, dateTime, known, number, t } from "../texts.js";
import { driveExtra, extraLead } from "./extra-card.js";

const SHOWN = 8;

/** Use the model, export with it, have the extra lines driven; `update(state)` keeps the last one true. */
export function closingCard(first, actions) {
  const { job, machine, discovery } = first;
  let latest = first;
  const said = h("p", { class: "quiet", role: "status" });
  const use = h("button", { class: "button", "data-needs": "operator", onclick: choose,
    disabled: discovery.verdict?.state === "not-usable" });
  const extra = discovery.ask && h("button", { class: "button", "data-needs": "operator",
    onclick: () => driveExtra(latest, actions) }, icon("play"), t("extra.drive"));
  const element = card(t("model.next"), h("div", { class: "downloads" }, use,
    linkButton(`#/export/${job.id}`, "download", t("model.export")), extra), said);
  element.dataset.closing = "";

  function choose() {
    useModel(modelInUse(machine) === job.id ? null : job.id, machine);
    show();
  }

  function show() {
    const isUsed = modelInUse(machine) === job.id;
    use.replaceChildren(icon(isUsed ? "cross" : "check"), t(isUsed ? "model.unuse" : "model.use"));
    said.textContent = t(use.disabled ? "model.not_usable" : isUsed ? "model.used" : "model.use_means");
  }

  show();
  return {
    element,
    update(state) {
      latest = state;
      if (extra) extra.disabled = Boolean(extraLead(state, actions)?.next.disabled);
    },
  };
}

/** Versions of the model, the newest first, each with its difference to the one before; filled once they are known. */
export function versionsCard(id) {
  const list = h("ol", { class: "versions" }, h("li", { class: "quiet" }, t("discover.loading")));
  api.modelVersions(id).then(
    (versions) => list.replaceChildren(...versions.slice(0, SHOWN).map(version)),
    (error) => {
      api.expectProblem(error);
      list.replaceChildren(h("li", { class: "quiet" }, t("model.no_versions")));
    });
  const element = card(t("model.versions"), list);
  element.dataset.versions = "";
  return element;
}

function version({ id, version: count, created, difference }) {
  return h("li", {}, h("b", {}, h("a", { href: `#/discover/${id}` }, t("model.version", { count: number(count) }))), " ",
    h("span", { class: "quiet" }, dateTime(created)),
    h("ul", {}, difference.length ? difference.map((change) => h("li", {}, h("span", { class: "tag" }, t(`model.${change.kind}`)), " ", changeOf(change)))
      : h("li", { class: "quiet" }, t("model.same"))));
}

/** A change names its effect: "backlash Y: width 6.39 ± 0.15 µm". */
function changeOf({ what, text }) {
  const [name, ...where] = what.split(" ");
  const word = [known(`effect.${name}`, name), ...where].join(" ");
  const isNamed = text.startsWith(`${what}: `);
  const said = sayDifference(isNamed ? text.slice(what.length + 2) : text);
  if (said === null || currentLanguage() === "en") return h("span", { lang: "en" }, text);
  return isNamed || !text.startsWith(what) ? `${word}: ${said}` : said;
}

/** That the next plan or analysis uses a model, and the way out; nothing where none is in use. */
export function modelNotice(machine) {
  const id = modelInUse(machine);
  if (!id) return "";
  const said = notice(null, t("model.in_use"), h("a", { href: `#/discover/${id}` }, t("model.look")));
  said.dataset.model = id;
  said.lastChild.append(h("button", { class: "button", onclick: () => {
    useModel(null, machine);
    said.parentElement.remove();
  } }, t("model.unuse")));
  return h("div", { class: "below" }, said);
}
