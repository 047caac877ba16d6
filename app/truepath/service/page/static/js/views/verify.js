/* The step Verify: a result held against points that it was not made from. */
import * as api from "../api.js";
import { h, mark } from "../dom.js";
import { heldId, isConnected, isVerification, reach, statesMachine } from "../flow.js";
import { card, head, notice, wordFormat } from "../parts.js";
import { t } from "../texts.js";
import { newMeasurement, onward } from "./onward.js";
import { basedOrder, keepOutChoice, refuseBased } from "./keep-out-card.js";
import { findProof, proofCards } from "./proof.js";
import { keptTolerance, toleranceField } from "./tolerance-field.js";

const KINDS = ["diagonals", "random-points", "bidirectional", "circles", "circles-in-motion"];
const ALONE = "circles-in-motion"; // a path; the others are standstills
const choices = { what: new Set(["diagonals", "random-points"]), tolerance_um: keptTolerance(), compensation_id: "" };

/** Button that leads on: to the points, or to the certificate once they have spoken. */
export function lead(state, { actions, go }) {
  const { job, busy } = state;
  if (!job) return { next: null };
  const id = heldId(state);
  const certify = onward("verify", state, go);
  const back = { label: t("step.export"), run: () => go(reach("export", state) ?? "#/records") };
  if (isVerification(job)) {
    const again = id ? { label: t("verify.again"), run: () => go(`#/verify/${id}`) } : newMeasurement(go);
    return { next: certify, back: id ? back : null, aside: again };
  }
  if (!isConnected(state.machine)) return { next: certify, back, reason: t("verify.not_connected") };
  const refused = busy ? t("plan.preparing") : refusal(machineIdOf(state));
  return { back, reason: refused, aside: { label: t("verify.skip"), run: certify.run },
    next: { key: "verify", label: t("verify.prepare"), disabled: Boolean(refused), run: () => actions.verify(order(id, machineIdOf(state))) } };
}

/** The machine that the result is of. */
const machineIdOf = ({ job, machine_id }) => job.machine ?? machine_id;

function refusal(machine_id) {
  if (!choices.what.size) return t("verify.none_chosen");
  if (refuseBased(machine_id)) return refuseBased(machine_id);
  return Number.isNaN(choices.tolerance_um) || choices.tolerance_um < 0 ? t("headline.tolerance_refused") : "";
}

const order = (id, machine_id) => ({
  result_id: id, ...basedOrder(machine_id), what: KINDS.filter((kind) => choices.what.has(kind)),
  ...(choices.tolerance_um ? { tolerance_um: choices.tolerance_um } : {}),
  ...(choices.compensation_id ? { compensation_id: choices.compensation_id } : {}),
});

/** Show what can be driven and held against what; or what came of it. */
export function mount(root, { store, actions }) {
  const body = h("div", { class: "stack" });
  let drawn = null;
  let shown = null;
  root.append(head(t("verify.title"), t("verify.text")), body);

  function ask(job, state) {
    choices.compensation_id = "";
    const before = h("div", { class: "stack" });
    body.replaceChildren(form(job, state, () => store.set({})), before);
    findProof(job.id, state.jobs).then((proof) => {
      if (proof) actions.did("verify", job.id);
      if (proof && drawn === job.id) showProof(before, proof, state, h("h2", {}, t("verify.before")));
    }, () => {});
  }

  function showProof(place, proof, state, ...first) {
    shown?.close();
    shown = proofCards(proof, proof.job.machine === state.machine_id ? state.machine : null);
    place.replaceChildren(...first, ...shown.cards);
  }

  return {
    update(state) {
      const { job, verification } = state;
      const wanted = isVerification(job) ? verification : job?.id;
      if (!job || !wanted || wanted === drawn || !(isVerification(job) || statesMachine(job))) return;
      drawn = wanted;
      if (isVerification(job)) showProof(body, { job, verification }, state);
      else ask(job, state);
    },
    close: () => shown?.close(),
  };
}

/** Choose the files that a simulated control of this job's machine has; say in `others` where they are not of this result. */
async function chooseLoaded(job, { system }, files, others, changed) {
  if (!system?.simulated || !job.machine) return;
  const { job_id, compensation_id } = await api.simulatedTables(job.machine);
  if (job_id && job_id !== job.id) others.replaceChildren(otherFiles(job_id));
  if (job_id !== job.id || files.value) return;
  files.value = choices.compensation_id = compensation_id;
  changed();
}

const otherFiles = (job_id) => notice("held", t("verify.other_files"), t("verify.other_files_text"),
  h("a", { href: `#/export/${job_id}` }, t("verify.other_files_open")));

function form(job, state, changed) {
  choices.tolerance_um = keptTolerance();
  const files = h("select", { id: "verify-files", onchange: () => {
    choices.compensation_id = files.value;
    changed();
  } }, h("option", { value: "" }, t("verify.as_found")));
  const others = h("div", { "aria-live": "polite" });
  api.compensations(job.id).then((kept) => files.append(...kept.map((made) =>
    h("option", { value: made.id }, nameFiles(made, kept)))))
    .then(() => chooseLoaded(job, state, files, others, changed)).catch(() => {});
  return h("div", { class: "columns" },
    h("section", { class: "card stack" }, h("h2", {}, t("verify.what")),
      h("div", { class: "stack", role: "group", "aria-label": t("verify.what") }, KINDS.map((kind) => kindBox(kind, changed)))),
    h("div", { class: "stack" },
      h("section", { class: "card stack" }, h("h2", {}, t("verify.against")), toleranceField("verify-tolerance", t("verify.tolerance"), (tolerance_um) => {
        choices.tolerance_um = tolerance_um;
        changed();
      }),
        h("div", { class: "field" }, h("label", { for: "verify-files" }, t("verify.state")), files,
          h("p", { class: "field-note" }, t("verify.state_note"))), others),
      keepOutChoice(machineIdOf(state), state.machine, changed),
      notice(null, t("verify.moves"), t("verify.moves_text"))));
}

/** Files by their control; by their name as well where it has others too. */
function nameFiles(made, kept) {
  const control = wordFormat(made.format, "control", made.control);
  const others = kept.filter(({ id, format }) => format === made.format && id !== made.id);
  return others.length ? t("verify.with_files", { control, name: made.id }) : t("verify.with_the_files", { control });
}

function kindBox(kind, changed) {
  const box = h("button", { class: "choice is-box", role: "checkbox", "data-kind": kind,
    "aria-checked": String(choices.what.has(kind)), onclick: () => {
      if (!choices.what.delete(kind)) {
        if (kind === ALONE) choices.what.clear();
        else choices.what.delete(ALONE);
        choices.what.add(kind);
      }
      for (const each of box.parentElement.children) mark(each, "aria-checked", String(choices.what.has(each.dataset.kind)));
      changed();
    } }, h("strong", {}, t(`verify.${kind}`)), h("span", {}, t(`verify.${kind}_text`)));
  return box;
}
