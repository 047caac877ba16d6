/* What the operator set on this panel: units, light or dark, language, tolerance, machine, model, keep-out boxes. */
const KEYS = { units: "mm", theme: "auto", scale: "common", tolerance_um: "", machine: "", model: "{}", keep_out: "{}" };

/** Read a preference. */
export function preference(name) {
  return localStorage.getItem(`truepath.${name}`) || KEYS[name];
}

/** Keep a preference. */
export function prefer(name, value) {
  localStorage.setItem(`truepath.${name}`, value);
}

/** What was chosen in this tab before a reload, else `usual`. */
export const recall = (name, usual) => ({ ...usual, ...JSON.parse(sessionStorage.getItem(`truepath.${name}`)) });

/** Keep a choice over a reload. */
export const retain = (name, chosen) => sessionStorage.setItem(`truepath.${name}`, JSON.stringify(chosen));

/** Keep the language where the service sees it, so that the shell comes in it next time. */
export function rememberLanguage(language) {
  document.cookie = `truepath_language=${language}; path=${new URL(".", document.baseURI).pathname}; max-age=31536000; SameSite=Strict`;
}
