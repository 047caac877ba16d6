/* The stated uncertainty, held against Monte Carlo trials or not yet. */
import { links } from "../api.js";
import { h, icon } from "../dom.js";
import { card, linkButton } from "../parts.js";
import { number, t } from "../texts.js";

/** What the trials say, with the way to the report; or the button that asks for them. */
export function trialsCard(job, result, actions) {
  const trials = result.monte_carlo;
  if (!trials) return job.run_id ? asking(job, actions) : null;
  const key = !trials.settled ? "trials.unsettled" : trials.agrees ? "trials.agrees" : "trials.differs";
  const counts = { trials: number(trials.trials), agreeing: number(trials.agreeing), numbers: number(trials.numbers) };
  return card(t("trials.title"), h("p", {}, t(key, counts)),
    h("div", {}, linkButton(links.report(job.id), "report", t("result.report"), { target: "_blank", rel: "noopener" })));
}

function asking(job, actions) {
  return card(t("trials.title"), h("p", { class: "quiet" }, t("trials.text")),
    h("div", {}, h("button", { class: "button", type: "button", "data-needs": "operator", onclick: () => actions.validate(job.run_id) },
      icon("check"), h("span", {}, t("trials.ask")))));
}
