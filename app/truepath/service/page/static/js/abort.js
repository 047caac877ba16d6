/* Abort: stands alone, so that it works when every other script of the page has failed.
 *
 * One touch sends the blanket stop, over a channel that is open already and as a POST:
 * other requests of all windows may have taken every connection for one. Again every 2 s
 * until the service takes it, then it asks for the jobs until none is under way; what the controllers say themselves, with the
 * answer to a stop, counts as well, and is there even after the session has ended. Without that word within 6 s the whole screen says
 * so, and goes on trying. Without any script the button is a plain form. Whether a stop
 * would arrive is tried when the page is shown and each minute; if not, it says so.
 */
(() => {
  "use strict";
  const RETRY_MS = 2000;
  const POLL_MS = 300;
  const CLICK_MS = 500; // after the release that it is of
  const CHECK_MS = 60000;
  const UNCONFIRMED_MS = 6000;
  const UNHEARD = new Set(["faulted", "interrupted"]);

  const form = document.getElementById("abort-form");
  const button = document.getElementById("abort");
  const sheet = document.getElementById("abort-sheet");
  const title = document.getElementById("abort-title");
  const text = document.getElementById("abort-text");
  const tries = document.getElementById("abort-tries");
  const alarm = document.getElementById("abort-alarm");
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

  const url = form.action;
  let channel = null;

  /** Open the channel, unless nobody sees the page: then nobody touches ABORT. */
  function open() {
    if (document.hidden || channel) return;
    const own = { socket: new WebSocket(url.replace(/^http/, "ws")), waiting: [] };
    channel = own;
    own.opened = new Promise((done) => { own.socket.onopen = done; });
    own.socket.onmessage = ({ data }) => own.waiting.shift()?.(data);
    own.socket.onclose = () => drop(own);
  }

  function drop(own) {
    own.socket.close();
    if (channel !== own) return;
    channel = null;
    setTimeout(open, RETRY_MS);
  }

  /** What the channel answers to a word; null if that is a refusal, late or none. */
  async function say(word) {
    open();
    const own = channel;
    if (!own) return null;
    let late = false;
    const answer = own.opened.then(() => new Promise((done) => {
      if (late) return;
      own.waiting.push(done);
      own.socket.send(word);
    }));
    const text = await Promise.race([answer, pause(RETRY_MS)]);
    late = true;
    // Dead, if it is not just slow to open: the next word is for another one.
    if (text === undefined && own.socket.readyState !== WebSocket.CONNECTING) drop(own);
    try {
      return JSON.parse(text);
    } catch {
      return null;
    }
  }

  /** The first answer of the service itself to a stop or a check; all of them are heard. */
  function reach(word, path, hear = () => {}) {
    const post = { method: "POST", keepalive: true, priority: "high" };
    const answers = [say(word), ask(path, post)].map(async (asked) => {
      const answer = await asked;
      if (!Array.isArray(answer?.machines)) throw new Error("nobody, or somebody else");
      hear(answer);
      return answer;
    });
    return Promise.any(answers).catch(() => null);
  }

  let checking = null;

  /** Prove the way of a stop; without an answer say so, and try again soon. */
  async function check() {
    clearTimeout(checking);
    if (document.hidden) return;
    open();
    const begun = performance.now();
    const reached = await reach("check", `${url}:check`) !== null;
    alarm.hidden = reached;
    clearTimeout(checking);
    const wait_ms = reached ? CHECK_MS : RETRY_MS - (performance.now() - begun);
    checking = setTimeout(check, Math.max(0, wait_ms));
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
    return answer.machines.length > 0 && answer.machines.every(({ stopped }) => stopped === "true");
  }

  function take(current, answer) {
    for (const job of answer.jobs) current.watched.add(job.id);
    current.taken = true;
    current.stands = current.stands || stands(answer);
    current.confirmed = current.confirmed || current.stands;
    if (current.confirmed && attempt === current) report(current);
  }

  async function send(current) {
    let count = 0;
    while (attempt === current && !current.confirmed) {
      const begun = performance.now();
      count += 1;
      current.count = count;
      const answer = await reach("stop", url, (one) => take(current, one));
      current.answered += answer === null ? 0 : 1;
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
      .replace("{m}", current.answered).replace("{s}", (waited_ms / 1000).toFixed(0));
    if (current.confirmed && current.watched.size) show("confirmed");
    else if (current.confirmed) show(current.stands ? "idle" : "unheard");
    else if (waited_ms > UNCONFIRMED_MS) show("unconfirmed", note);
    else show(current.taken ? "waiting" : "sending", note);
  }

  function abort() {
    if (attempt && !attempt.confirmed) return;
    const followed = document.body.dataset.measuring;
    attempt = { begun: performance.now(), taken: false, stands: false, confirmed: false, count: 0, answered: 0,
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
  document.addEventListener("visibilitychange", () => {
    if (document.hidden && channel && (!attempt || attempt.confirmed)) {
      const own = channel;
      channel = null;
      own.socket.close();
    }
    check();
  });
  check();
  close.addEventListener("click", () => {
    // Not confirmed, but a person has seen that the machine stands.
    attempt = null;
    sheet.hidden = true;
    button.focus();
  });
})();
