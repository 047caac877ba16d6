/* What has to be so around the machine, and that no device can tell: read before the hold. */
import { h, icon } from "../dom.js";
import { card } from "../parts.js";
import { t } from "../texts.js";

const TEXTS = ["check.before_clear", "check.before_reflector", "check.before_sight"];

/** Whether each sentence has been in sight since the job asks to be armed. */
export const isSafetyRead = (read, job) => Boolean(read) && read.key === keyOf(job) && read.count === TEXTS.length;

/** Armed once more, as after the tracker was moved, it is to be read once more. */
const keyOf = (job) => `${job.id}:${job.station?.number ?? 1}:${job.state}`;

/** Card with the sentences; keeps `safetyRead` of the store; `close` ends the watching. */
export function safetyCard(store) {
  const items = TEXTS.map((key) => h("li", {}, icon("warning"), t(key)));
  const seen = new Set();
  const style = getComputedStyle(document.documentElement);
  const [top, bottom] = ["--bar", "--footer"].map((name) => Number.parseFloat(style.getPropertyValue(name)));
  // What lies under the bar or behind the button is not in sight.
  const watcher = new IntersectionObserver(note, { threshold: 0.99, rootMargin: `-${top}px 0px -${bottom}px 0px` });
  let key = "";

  function note(entries) {
    for (const { isIntersecting, target } of entries) if (isIntersecting) seen.add(target);
    store.set({ safetyRead: { key, count: seen.size } });
  }

  return {
    element: h("div", { class: "safety below" }, card(t("check.before"), h("ul", { class: "before" }, items))),
    update(job) {
      if (!job || keyOf(job) === key) return;
      key = keyOf(job);
      seen.clear();
      watcher.disconnect();
      for (const item of items) watcher.observe(item); // tells at once what is in sight already
    },
    close: () => watcher.disconnect(),
  };
}
