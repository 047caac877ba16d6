/* Abort: stands alone, so that it works when every other script of the page has failed.
 *
 * One touch posts the blanket stop, again every 2 s until the service takes it, then asks
 * for the jobs until none is under way; what the controllers say themselves, with the
 * answer to a stop, counts as well, and is there even after the session has ended. Without that word within 6 s the whole screen says
 * so, and goes on trying. Without any script the button is a plain form.
 */
(() => {
  "use strict";
  const RETRY_MS = 2000;
  const POLL_MS = 300;
  const CLICK_MS = 500; // after the release that it is of
  const UNCONFIRMED_MS = 6000;
  const UNHEARD = new Set(["faulted", "interrupted"]);

  const form = document.getElementById("abort-form");
  const button = document.getElementById("abort");
  const sheet = document.getElementById("abort-sheet");
  const title = document.getElementById("abort-title");
  const text = document.getElementById("abort-text");
  const tries = document.getElementById("abort-tries");
  const close = document.getElementById("abort-close");
  let attempt = null;

  function show(stage, note) {
    sheet.hidden = false;
    sheet.dataset.stage = stage;
    title.textContent = sheet.dataset["abort" + capital(stage)];
    text.textContent = sheet.dataset["abort" + capital(stage) + "Text"];
    tries.textContent = note || "";
    const word = stage === "unconfirmed" ? "Acknowledge" : "Close";
    const shut = stage === "sending" || stage === "waiting";
    close.textContent = sheet.dataset["abort" + word];
    if (!shut && close.hidden) setTimeout(() => close.focus());
    close.hidden = shut;
  }

  function capital(word) {
    return word[0].toUpperCase() + word.slice(1);
  }

  const pause = (ms) => new Promise((done) => setTimeout(done, ms));

  /** The whole answer; null if it is refused, late, cut short or no JSON. */
  async function ask(path, options) {
    const limit = new AbortController();
    const timer = setTimeout(() => limit.abort(), RETRY_MS);
    try {
      const answer = await fetch(path, { ...options, signal: limit.signal });
      return answer.ok ? await answer.json() : null;
    } catch {
      return null;
    } finally {
      clearTimeout(timer);
    }
  }

  /** Ids of jobs that may still move the machine, verifications among them; null if nobody lists them.
   *
   * A job that faulted during the abort counts, or that the service left behind when it
   * ended: the machine has not said that it stands.
   */
  async function underWay(watched) {
    const page = await ask(sheet.dataset.unsettledJobs, { cache: "no-store" });
    if (!Array.isArray(page?.items)) return null;
    return page.items
      .filter((job) => job.kind.startsWith("measure-") || job.kind === "verify")
      .filter((job) => !UNHEARD.has(job.state) || watched.has(job.id))
      .map((job) => job.id);
  }

  /** Whether every controller has said itself that it stands. Needs no session. */
  function stands(answer) {
    const machines = answer?.machines ?? [];
    return machines.length > 0 && machines.every(({ stopped }) => stopped === "true");
  }

  async function send(current) {
    let count = 0;
    while (attempt === current && !current.confirmed) {
      const begun = performance.now();
      count += 1;
      current.count = count;
      const answer = await ask("/api/v1/stop", { method: "POST", keepalive: true });
      for (const job of answer?.jobs ?? []) current.watched.add(job.id);
      current.taken = current.taken || answer !== null;
      current.stands = current.stands || stands(answer);
      current.confirmed = current.confirmed || current.stands;
      if (current.confirmed && attempt === current) report(current);
      await pause(Math.max(0, RETRY_MS - (performance.now() - begun)));
    }
  }

  async function watch(current) {
    while (attempt === current && !current.confirmed) {
      if (current.taken) {
        const ids = await underWay(current.watched);
        for (const id of ids || []) current.watched.add(id);
        current.confirmed = ids !== null && ids.length === 0;
      }
      if (!current.confirmed) await pause(POLL_MS);
      if (attempt === current) report(current);
    }
  }

  function report(current) {
    const waited_ms = performance.now() - current.begun;
    const note = sheet.dataset.abortTries.replace("{n}", current.count)
      .replace("{s}", (waited_ms / 1000).toFixed(0));
    if (current.confirmed && current.watched.size) show("confirmed");
    else if (current.confirmed) show(current.stands ? "idle" : "unheard");
    else if (waited_ms > UNCONFIRMED_MS) show("unconfirmed", note);
    else show(current.taken ? "waiting" : "sending", note);
  }

  function abort() {
    if (attempt && !attempt.confirmed) return;
    const followed = document.body.dataset.measuring;
    attempt = { begun: performance.now(), taken: false, stands: false, confirmed: false, count: 0,
      watched: new Set(followed ? [followed] : []) };
    report(attempt);
    send(attempt);
    watch(attempt);
  }

  // On touch-down, not on release: a gloved finger that slides still stops the machine.
  let isDown = false;
  let released_ms = -Infinity;
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    isDown = true;
    abort();
  });
  // The release of a long press is no second order: what the first has done stays shown.
  // A click by touch comes some time after it; one of no press, or by a key, is an order.
  function release() {
    if (isDown) released_ms = performance.now();
    isDown = false;
  }
  for (const end of ["pointerup", "pointercancel", "mouseup"]) {
    window.addEventListener(end, release, true);
  }
  window.addEventListener("blur", release); // of the window alone: that of elements stays there
  button.addEventListener("click", (event) => {
    const isOfPress = isDown || performance.now() - released_ms < CLICK_MS;
    if (isOfPress && event.detail > 0) event.preventDefault();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    abort();
  });
  close.addEventListener("click", () => {
    // Not confirmed, but a person has seen that the machine stands.
    attempt = null;
    sheet.hidden = true;
    button.focus();
  });
})();
