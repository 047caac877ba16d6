/* Upload of a measurement bundle, to analyse what was recorded elsewhere. */
import { h, icon } from "../dom.js";
import { t } from "../texts.js";

/** A place to drop or choose a bundle. */
export function dropZone(store, actions) {
  const input = h("input", { type: "file", accept: ".zip,application/zip", id: "bundle",
    "aria-label": t("upload.choose"), tabindex: "-1" });
  const button = h("button", { class: "button", onclick: () => input.click() },
    icon("upload"), t("upload.choose"));
  const zone = h("div", { class: "drop", "data-needs": "operator" }, h("p", {}, t("upload.text")), input, button);
  const send = async (file) => {
    if (!file) return;
    button.disabled = true;
    button.lastChild.textContent = t("upload.sending");
    await actions.upload(file);
    button.disabled = false;
    button.lastChild.textContent = t("upload.choose");
    input.value = "";
  };
  input.addEventListener("change", () => send(input.files[0]));
  zone.addEventListener("dragover", (event) => {
    event.preventDefault();
    zone.classList.add("is-over");
  });
  zone.addEventListener("dragleave", () => zone.classList.remove("is-over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("is-over");
    send(event.dataTransfer.files[0]);
  });
  return zone;
}
