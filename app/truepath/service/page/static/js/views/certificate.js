/* The step Certificate: who the machine is, issue, look at it, take it; and those that were issued. */
import * as api from "../api.js";
import { h } from "../dom.js";
import { isMeasuring, reach, statesTables } from "../flow.js";
import { card, head, linkButton, notice, segments, wordFormat } from "../parts.js";
import { currentLanguage, dateTime, languages, t } from "../texts.js";
import { decisionOf, findProof } from "./proof.js";
import { newMeasurement } from "./onward.js";

const GROUPS = {
  machine: ["machine_maker", "machine_model", "serial_number", "control", "customer", "place"],
  tracker: ["tracker", "tracker_serial_number", "tracker_certificate", "tracker_calibrated_on", "target"],
  measurement: ["operator", "laboratory", "authorised_by", "condition", "received_on", "measured_on", "warm_up", "deviations"],
};
const NAMES = { en: "English", de: "Deutsch" };
const LONGEST = 200;

/** What is going to be issued: of one result at a time. */
let order = null;
let taken = () => {};

/** Button that leads on: issues; afterwards the task is done. */
export function lead(state, { actions, store, go }) {
  const { job, busy, issued, result } = state;
  if (!job) return { next: null };
  const back = { label: t("step.verify"), run: () => go(reach("verify", state) ?? "#/records") };
  if (busy === "issue") return { back, reason: t("certificate.issuing_text"), next: { key: "issuing", label: t("certificate.issuing"), disabled: true } };
  const issue = async () => {
    const certificate = await actions.issue(job.id, orderOf(order));
    if (!certificate) return;
    store.set({ issued: job.id });
    taken(certificate);
  };
  if (result?.verdict?.state === "not-usable") return { back, next: { key: "measure", ...newMeasurement(go) }, reason: t("certificate.not_usable") };
  const isReady = order?.job_id === job.id;
  if (issued === job.id) return { back, next: { key: "measure", ...newMeasurement(go) }, aside: { label: t("certificate.issue_again"), disabled: !isReady || Boolean(busy), run: issue } };
  return { back, next: { key: "issue", label: t("certificate.issue"), disabled: !isReady || Boolean(busy), run: issue } };
}

const orderOf = ({ language, identity, proof, proves, files }) => ({
  language, identity,
  ...(proof && proves ? { verification_job: proof.job.id } : {}),
  ...(files ? { compensation_id: files } : {}),
});

/** Show what is stated, the certificate, and all that were issued of the result. */
export function mount(root, { store, actions }) {
  order = null; // of an earlier look: a verification may have come since
  const stated = h("div", { class: "stack" });
  const preview = h("section", { class: "card preview-card" });
  const list = h("div");
  let drawn = null;
  root.append(head(t("certificate.title"), t("certificate.text")),
    h("div", { class: "columns is-certificate" }, h("div", { class: "stack" }, stated, list), preview));
  taken = async (certificate) => {
    const { items } = await api.certificates(drawn).catch(() => ({ items: [certificate] }));
    showAll(items, certificate);
  };

  const show = async (certificate) => preview.replaceChildren(...await previewOf(certificate));

  function showAll(items, chosen) {
    list.replaceChildren(...issuedList(items, show));
    show(chosen);
  }

  async function look() {
    const made = await actions.preview(drawn, orderOf(order));
    if (made) show(made);
  }

  async function load(job, jobs) {
    const [kept, proof, files] = await Promise.all([api.certificates(job.id), findProof(job.id, jobs), api.compensations(job.id)]);
    if (drawn !== job.id) return;
    for (const [step, found] of [["export", files.length], ["verify", proof]]) if (found) actions.did(step, job.id);
    const { machine } = store.get();
    order = { job_id: job.id, language: currentLanguage(), identity: await identityOf(job, kept.identity, machine), proof, proves: Boolean(proof), files: verifiedFiles(proof, files), others: hasOtherFiles(proof, job) };
    stated.replaceChildren(...form(order, files, look));
    showAll(kept.items, kept.items.at(-1) ?? null);
    store.set({});
  }

  return {
    update({ job, jobs }) {
      if (!job || job.id === drawn || !statesTables(job)) return;
      drawn = job.id;
      load(job, jobs).catch(actions.refuse);
    },
    close() {
      drawn = null; // what is still being read is of no use
      taken = () => {};
    },
  };
}

/** What is known already: as stated last, then as the machine's own record has it. */
async function identityOf(job, kept, machine) {
  const record = job.machine ? await api.machineRecord(job.machine).catch(() => null) : null;
  const { tracker } = machine ?? {};
  const ofTracker = tracker && isMeasuring(job) ? { tracker: `${tracker.maker} ${tracker.model}`.trim(), tracker_serial_number: tracker.serial_number } : {};
  const ofMachine = record ? { machine_maker: record.maker, machine_model: record.model, serial_number: record.serial_number,
    control: record.control, customer: record.customer, place: record.place } : {};
  const all = Object.values(GROUPS).flat();
  return Object.fromEntries(all.map((name) => [name, ofMachine[name] || kept[name] || ofTracker[name] || ""]));
}

/** The kept files that the control had while it was verified; empty where there are none. */
function verifiedFiles(proof, files) {
  const name = proof?.verification.asked.compensation_id;
  return files.some(({ id }) => id === name) ? name : "";
}

/** Whether the control had files of a discovery while it was verified: the service takes their account by itself. */
const hasOtherFiles = (proof, job) => Boolean(proof?.verification.asked.compensation_id) && proof.verification.asked.result_id !== job.id;

function form(order, files, look) {
  const choose = h("select", { id: "certificate-files", onchange: () => Object.assign(order, { files: choose.value }) }, h("option", { value: "" }, t(order.others ? "certificate.files_of_proof" : "certificate.no_files")), files.map((made) => h("option", { value: made.id }, wordFormat(made.format, "control", made.control))));
  choose.value = order.files;
  const groups = Object.entries(GROUPS).map(([group, names]) => [h("h3", {}, t(`certificate.of_${group}`)),
    h("div", { class: "text-fields" }, names.map((name) => textField(order.identity, name)))]);
  return [h("section", { class: "card stack", "data-card": "identity" }, h("h2", {}, t("certificate.content")),
    h("div", { class: "field" }, h("span", { class: "label" }, t("settings.language")),
      segments(t("settings.language"), languages.map((one) => [one, NAMES[one] ?? one]), order.language, (language) => Object.assign(order, { language }))),
    proofField(order),
    files.length > 0 && h("div", { class: "field" }, h("label", { for: "certificate-files" }, t("certificate.files")), choose),
    h("button", { class: "button", type: "button", onclick: look }, t("certificate.preview"))),
  h("section", { class: "card stack", "data-card": "stated" }, h("h2", {}, t("certificate.stated")),
    h("p", { class: "quiet" }, t("certificate.stated_text")), groups)];
}

/** The verification that goes with it, or that there is none. */
function proofField(order) {
  if (!order.proof) return h("p", { class: "quiet" }, t("certificate.no_proof"));
  const { job, verification } = order.proof;
  const word = t(`verify.is_${decisionOf(verification)}`);
  const box = h("button", { class: "choice is-box", role: "checkbox", "aria-checked": "true", onclick: () => {
    order.proves = !order.proves;
    box.setAttribute("aria-checked", String(order.proves));
  } }, h("strong", {}, t("certificate.with_proof")), h("span", {}, `${dateTime(job.ended ?? job.created)} · ${word}`));
  return box;
}

function textField(identity, name) {
  const id = `state-${name}`;
  const input = h("input", { id, value: identity[name], maxlength: LONGEST, autocomplete: "off", oninput: () => Object.assign(identity, { [name]: input.value }) });
  return h("div", { class: "text-field" }, h("label", { for: id }, t(`identity.${name}`)), input);
}

function issuedList(items, show) {
  if (!items.length) return [];
  const rows = items.toReversed().map((one) => h("li", {},
    h("div", {}, h("strong", { class: "number" }, one.number),
      h("p", { class: "quiet" }, [dateTime(one.issued_at), NAMES[one.language] ?? one.language, one.issued_by].filter(Boolean).join(" · "))),
    h("div", { class: "row-actions" },
      h("button", { class: "button", onclick: () => show(one) }, t("certificate.show")), download(one))));
  return [card(t("certificate.issued"), h("ul", { class: "kept-list" }, rows))];
}

/** The PDF; where none could be printed the page. */
const hasPdf = ({ files }) => "certificate.pdf" in files;
const download = (one) => (hasPdf(one) ? linkButton(one.links.pdf, "download", "PDF", { download: `${one.number}.pdf` })
  : linkButton(one.links.html, "download", "HTML", { download: `${one.number}.html` }));

/** The certificate as it was issued, or would be, in a frame that runs nothing. */
async function previewOf(certificate) {
  if (!certificate) {
    return [h("h2", {}, t("certificate.preview")), h("div", { class: "preview-none" }, h("p", {}, t("certificate.preview_none")))];
  }
  const { number = t("certificate.preview"), links, html } = certificate;
  const title = h("div", { class: "card-head" }, h("h2", {}, number),
    links && h("div", { class: "row-actions" }, linkButton(links.html, "expand", t("certificate.open"), { target: "_blank", rel: "noopener" }), download(certificate)));
  try {
    const frame = h("iframe", { class: "preview", sandbox: "", title: t("certificate.preview_of", { number }) });
    frame.srcdoc = html ?? await api.certificatePage(certificate);
    return [title, frame];
  } catch (error) {
    if (!(error instanceof api.Problem) && !(error instanceof TypeError)) throw error;
    return [title, notice("held", t("problem.unreachable"), t("certificate.preview_failed"))];
  }
}
