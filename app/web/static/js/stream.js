/* Live events: one stream a tab, and the age of what is shown. */
import { links } from "./api.js";

export const STALE_MS = 2500;
const REOPEN_MS = 2000;
const CHECK_MS = 250;

/** Listen to the service; `hear(type, data)` for each event, `age(link)` as time passes.
 *
 * "open" is heard when events begin: what was told before is to be asked for; "refused"
 * when the service answers without a stream.
 * link: {stale: bool, last: ms of the wall clock of the last event or null}
 */
export function listen(hear, age) {
  let source = null;
  let last = null;
  let heard_ms = performance.now();

  function open() {
    source = new EventSource(links.events);
    for (const type of ["tick", "job", "progress", "live", "estimate"]) {
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
    age({ stale: performance.now() - heard_ms > STALE_MS, last });
  }

  open();
  setInterval(check, CHECK_MS);
}
