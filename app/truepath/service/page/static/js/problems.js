/* What the service refuses or reports, in the language of the page. */
import { Problem } from "./api.js";
import { h } from "./dom.js";
import { sayFault } from "./fault-statements.js";
import { currentLanguage, known, t } from "./texts.js";

const SPOKEN_BY_SERVICE = "en";

/** Title, text and way out of a problem (RFC 9457), by its code where the catalogue has it.
 *
 * Sentences of the service that have no translation, or hold numbers that one leaves out, stay
 * and are marked as English.
 */
export function wordProblem({ code = "", title = "", detail = "", action = "" }) {
  if (code === "unreachable") return { title: t("problem.unreachable"), text: "", action: t("problem.unreachable_action") };
  if (code === "unanswered") return { title: t("problem.unanswered"), text: t("problem.unanswered_text"), action: t("problem.unanswered_action") };
  const key = `problem.code.${code}`;
  const isBare = !detail || detail === title || detail === `${title}.`;
  return {
    title: known(key, title || t("problem.refused")),
    text: isBare ? known(`${key}_text`, "") : textOf(code, detail),
    action: known(`${key}_action`, "") || quote(action),
  };
}

/** What is wrong with an input and what to do, in nodes of one line: of the service, or of the page itself. */
export function lineOf(error) {
  if (!(error instanceof Problem)) return [error.message];
  const { title, text, action } = wordProblem(error);
  return [text || title, action && " ", action].flat();
}

function textOf(code, detail) {
  if (currentLanguage() === SPOKEN_BY_SERVICE) return detail;
  const said = sayFault(code, detail);
  if (said !== null) return said;
  const translated = known(`problem.code.${code}_text`, "");
  if (!translated) return quote(detail);
  return /\d/.test(detail) ? [translated, " ", quote(`(${detail})`)] : translated;
}

/** A sentence of the service. */
function quote(sentence) {
  if (!sentence || currentLanguage() === SPOKEN_BY_SERVICE) return sentence;
  return h("span", { lang: SPOKEN_BY_SERVICE }, sentence);
}
