/* Live events: one stream a tab, and the age of what is shown. While none come, the
 * service is asked instead. */
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
 * when the service answers without a stream.
 * link: {stale: bool, asked: bool, last: ms of the wall clock of the last word or null,
 * age_s: whole seconds since it, of stale data}; asked: no events come, but answers do
 */
export function listen(hear, age, ask) {
  let source = null;
  let last = null;
  let heard_ms = performance.now();
  let answered_ms = -Infinity;
  let asking = false;

  function open() {
    source = new EventSource(links.events);
    for (const type of ["tick", "job", "progress", "live", "estimate", "condition"]) {
      source.addEventListener(type, (event) => receive(type, event));
    }
    source.addEventListener("open", () => hear("open", {}));
    source.addEventListener("error", reopen);
  }

  function receive(type, event) {
    last = Date.now();
    heard_ms = performance.now();
    hear(type, event.data ? JSON.parse(event.data) : {});
  }

  // The browser reconnects by itself, except after a refusal.
  function reopen() {
    if (source.readyState !== EventSource.CLOSED) return;
    source.close();
    hear("refused", {});
    setTimeout(open, REOPEN_MS);
  }

  function check() {
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

  open();
  setInterval(check, CHECK_MS);
}
