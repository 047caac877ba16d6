/* The step Export: the errors in the form that a control corrects by. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { controlOf, isDiscovery, reach, statesTables } from "../flow.js";
import { card, head, linkButton, notice, problemNotice, wordFormat } from "../parts.js";
import { COVERAGE } from "../plots/error-chart.js";
import { t } from "../texts.js";
import { quantity } from "../units.js";
import { exportCard, isOwn } from "./export-card.js";
import { newMeasurement, onward } from "./onward.js";

/** Button that leads on. */
export function lead(state, { go }) {
  const { job } = state;
  if (!job) return { next: null };
  const before = isDiscovery(job) ? "discover" : "result";
  return { next: onward("export", state, go), aside: newMeasurement(go),
    back: { label: t(`step.${before}`), run: () => go(reach(before, state)) } };
}

/** Show the choice of controls, and the files that were made before. */
export function mount(root, { actions }) {
  const body = h("div", { class: "stack" });
  let shown = null;
  root.append(head(t("export.title"), t("export.text")), body);

  function show(job, { verdict, volumetric_error: stated }, state) {
    const kept = h("div");
    const own = controlOf(state);
    const loader = simulatedLoader(job, state, () => relist());
    const list = async () => {
      const [all, loaded] = await Promise.all([api.compensations(job.id), loader?.read()]);
      const found = all.sort((a, b) => isOwn(b, own) - isOwn(a, own));
      if (found.length) actions.did("export", job.id);
      kept.replaceChildren(...keptFiles(found, loader && ((made) => loader.button(made, loaded)), loader?.said));
    };
    const relist = () => list().catch(() => {});
    const making = exportCard(job, { verdict, stated_um: stated?.before?.mean.value_um, own }, relist);
    body.replaceChildren(making ?? notice("fault", t("export.not_usable"), t("export.not_usable_text")),
      h("div", { "data-only": "without-metrologist" }, notice(null, t("session.metrologist_only"))), kept);
    relist();
  }

  return {
    update(state) {
      const { job, result, discovery } = state;
      const found = job && (statesTables(job) ? result : isDiscovery(job) && discovery);
      if (!found || shown === found) return;
      shown = found;
      show(job, found, state);
    },
    close() {},
  };
}

/** Files that were made of this result, to be taken again.
 *
 * load(made): what loads them into a simulated control, if there is one; said: how that went
 */
function keptFiles(found, load, said) {
  if (!found.length) return [];
  return [card(t("export.kept"), h("ul", { class: "kept-list" }, found.map((made) => h("li", {},
    h("div", {}, h("strong", {}, wordFormat(made.format, "control", made.control)), h("p", { class: "quiet" }, left(made))),
    load?.(made), linkButton(made.links.archive, "download", t("export.take"), { download: "" })))), said)];
}

const left = ({ volumetric_error_um: { after } }) => t("export.kept_leaves", {
  value: quantity(after.mean, "gap"), u: quantity(COVERAGE * after.mean_uncertainty, "gap"), k: COVERAGE });

/** What loads files of a job into its simulated control; null where the devices are real.
 *
 * changed(): hears that the control has others now
 */
function simulatedLoader(job, { system }, changed) {
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
        h("button", { class: "button", "data-needs": "metrologist", "data-unload": made.id,
          onclick: () => order(() => api.clearSimulatedTables(job.machine)) }, t("export.unload")));
    }
    return h("button", { class: "button", "data-needs": "metrologist", "data-load": made.id,
      onclick: () => order(() => api.loadSimulatedTables(job.machine, { job_id: job.id, compensation_id: made.id })),
    }, t("export.load"));
  }

  return { said, button, read: () => api.simulatedTables(job.machine) };
}

function refusal(error) {
  api.expectProblem(error);
  return [problemNotice(error)];
}
