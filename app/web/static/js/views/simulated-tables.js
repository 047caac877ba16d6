/* Files into the control of a simulated machine: from as found to as left in one go. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { problemNotice } from "../parts.js";
import { t } from "../texts.js";

/** What loads files of a job into its simulated control; null where the devices are real.
 *
 * changed(): hears that the control has others now
 */
export function simulatedLoader(job, { system }, changed) {
  if (!system?.simulated || !job.machine) return null;
  const said = h("div", { "aria-live": "polite" });

  async function order(request) {
    said.replaceChildren(...await request().then(() => [], refusal));
    changed();
  }

  /** Button for kept files, or the word that the control has them. */
  function button(made, loaded) {
    if (loaded.job_id === job.id && loaded.compensation_id === made.id) {
      return h("span", { class: "row-actions" }, h("span", { class: "tag" }, t("export.loaded")),
        h("button", { class: "button", type: "button", "data-needs": "metrologist", "data-unload": made.id,
          onclick: () => order(() => api.clearSimulatedTables(job.machine)) }, t("export.unload")));
    }
    return h("button", { class: "button", type: "button", "data-needs": "metrologist", "data-load": made.id,
      onclick: () => order(() => api.loadSimulatedTables(job.machine, { job_id: job.id, compensation_id: made.id })),
    }, t("export.load"));
  }

  return { said, button, read: () => api.simulatedTables(job.machine) };
}

function refusal(error) {
  if (!(error instanceof api.Problem)) throw error;
  return [problemNotice(error)];
}
