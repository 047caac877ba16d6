/* Texts by key out of the catalogues, and numbers as the language writes them. */
let language = document.body.dataset.language;
let texts = JSON.parse(document.getElementById("catalogue").textContent);

/** Languages that have a catalogue. */
export const languages = document.body.dataset.languages.split(" ");

/** The language in use. */
export const currentLanguage = () => language;

/** How numbers and dates are written: as in the browser's region, if it speaks the language. */
const region = () => navigator.languages.find((tag) => tag.split("-")[0] === language) ?? language;

/** Text of a key; `{name}` is replaced by values.name. */
export function t(key, values = {}) {
  const text = texts[key];
  if (text === undefined) {
    console.error(`no text for ${key}`);
    return key;
  }
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/** Text of a key, or `otherwise` where the catalogue has none: for words of the service. */
export function known(key, otherwise, values = {}) {
  return key in texts ? t(key, values) : otherwise;
}

/** Load another language and translate the shell. */
export async function speak(wanted) {
  const answer = await fetch(new URL(`../locales/${wanted}.json`, import.meta.url));
  if (answer.status === 404) location.reload();  // the service has another page now
  if (!answer.ok) throw new Error(`catalogue ${wanted}: ${answer.status}`);
  texts = await answer.json();
  language = wanted;
  document.documentElement.lang = wanted;
  translateShell();
}

function translateShell() {
  for (const element of document.querySelectorAll("[data-text]")) {
    element.textContent = t(element.dataset.text);
  }
  for (const element of document.querySelectorAll("[data-text-label]")) {
    element.setAttribute("aria-label", t(element.dataset.textLabel));
  }
  const sheet = document.getElementById("abort-sheet");
  for (const name of Object.keys(sheet.dataset).filter((n) => n.startsWith("abort"))) {
    const key = name.slice("abort".length).replace(/Text$/, "_text").toLowerCase();
    sheet.dataset[name] = t(`abort.${key}`);
  }
}

/** A number with a fixed count of decimals; an em dash where there is none. */
export function number(value, decimals = 0) {
  if (value === null || value === undefined || !Number.isFinite(Number(value))) return "–";
  const format = { minimumFractionDigits: decimals, maximumFractionDigits: decimals };
  const text = new Intl.NumberFormat(region(), format).format(value);
  return text.replace(/^-(?=[0.,]*$)/, "").replace("-", "−");
}

/** A number for an input field: no grouping. */
export function plain(value, decimals = 0) {
  if (!Number.isFinite(value)) return "";
  const format = { maximumFractionDigits: decimals, useGrouping: false };
  return new Intl.NumberFormat(region(), format).format(value);
}

/** A typed number, grouping and decimal sign as the language writes them; null where nothing is typed. */
export function typed(text) {
  const sign = number(1.5, 1)[1];
  const group = sign === "," ? /[.\s]/g : /[,\s]/g;
  const digits = text.replace(group, "").replace(sign, ".");
  return digits === "" ? null : Number(digits);
}

/** Seconds as m:ss or h:mm:ss. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  const whole = Math.max(0, Math.round(seconds));
  const two = (n) => String(n).padStart(2, "0");
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  return hours ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
}

/** Time of day of a moment. */
export function clock(moment) {
  return new Intl.DateTimeFormat(region(), { timeStyle: "medium" }).format(moment);
}

/** Day and month of an ISO stamp. */
export const day = (stamp) => new Intl.DateTimeFormat(region(), { day: "numeric", month: "short" }).format(new Date(stamp));

/** A name that the service gives, its ISO stamps as people write them. */
export const named = (text) => text.replace(/\d{4}-\d\d-\d\dT[\d:.]+Z/g, dateTime);

/** Date and time of an ISO stamp. */
export function dateTime(stamp) {
  if (!stamp) return "–";
  const style = { dateStyle: "medium", timeStyle: "short" };
  return new Intl.DateTimeFormat(region(), style).format(new Date(stamp));
}
