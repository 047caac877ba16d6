/* The card that gives the path as an NC program, for a control without a link. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { card, linkButton } from "../parts.js";
import { t } from "../texts.js";

/** A card with a download a control, there as soon as the job has a plan. */
export function programCard() {
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
