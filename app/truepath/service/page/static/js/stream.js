/* Live events over a WebSocket, and the age of what is shown. While none come, the
 * service is asked instead. Other streams would take the six connections that a browser
 * has for a service, in all its windows together; what is left then is no ABORT. */
import { links, Problem } from "./api.js";

export const STALE_MS = 2500;
const REOPEN_MS = 2000;
const CHECK_MS = 250;
const ASK_MS = 1000;

/** Listen to the service; `hear(type, data)` for each event, `age(link)` as time passes.
 *
 * Where no event has come for a while, `ask()` is called each second; it answers once the
 * service has said what the events would have told.
 * "open" is heard when events begin: what was told before is to be asked for; "refused"
 * when there is no stream any more.
 * link: {stale: bool, asked: bool, last: ms of the wall clock of the last word or null,
 * age_s: whole seconds since it, of stale data}; asked: no events come, but answers do
 */
export function listen(hear, age, ask) {
  let socket = null;
  let known = "";
  let last = null;
  let heard_ms = performance.now();
  let answered_ms = -Infinity;
  let asking = false;

  // A tab that nobody sees lets go of its stream; it catches up once it is shown.
  function open() {
    if (document.hidden || socket) return;
    socket = new WebSocket(`${links.events}?last_event_id=${known}`);
    socket.addEventListener("open", () => hear("open", {}));
    socket.addEventListener("message", receive);
    socket.addEventListener("close", reopen);
  }

  function receive({ data: text }) {
    const { event, id, data } = JSON.parse(text);
    last = Date.now();
    heard_ms = performance.now();
    known = id ?? data.last_event_id ?? known;
    hear(event, data);
  }

  function reopen() {
    socket = null;
    hear("refused", {});
    setTimeout(open, REOPEN_MS);
  }

  function turn() {
    if (!document.hidden) return open();
    document.title = "Truepath"; // of a state that is not followed
    socket?.removeEventListener("close", reopen);
    socket?.close();
    socket = null;
  }

  function check() {
    if (document.hidden) return;
    const now = performance.now();
    const silent = now - heard_ms > STALE_MS;
    const asked = now - answered_ms <= STALE_MS;
    const stale = silent && !asked;
    if (silent && !asking) askNow();
    const age_s = stale ? Math.floor((now - Math.max(heard_ms, answered_ms)) / 1000) : 0;
    age({ stale, asked: silent && asked, last, age_s });
  }

  async function askNow() {
    asking = true;
    try {
      await ask();
      answered_ms = performance.now();
      last = Date.now();
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
    } finally {
      setTimeout(() => { asking = false; }, ASK_MS);
    }
  }

  document.addEventListener("visibilitychange", turn);
  open();
  setInterval(check, CHECK_MS);
}
