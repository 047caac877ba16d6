/* Tracker and control while the machine moves: the scope, the beam, what was lost, temperatures. */
import { h, mark, write } from "../dom.js";
import { isMoving } from "../flow.js";
import { tile, wordOf } from "../parts.js";
import { drawStrip } from "../plots/strip-chart.js";
import { wordProblem } from "../problems.js";
import { known, number, t } from "../texts.js";
import { decimalsOf, quantity, unitOf } from "../units.js";

const SPACING_S = 0.1; // of the points of an event
const SILENT_MS = 1500;
const UNDER_WAY_MS = 1000; // points from before a loss may come so much later
const OF_CONTROL = /^(motion-|control-|position-|held-at-machine|feed-override|not-moving|hold-|stop-|resume-|ended-early|runs-on)/;

/** What the tracker's link counts: its key in the job's health, and whether any is too many. */
const COUNTS = [["samples", "run.samples", false], ["lost_samples", "run.lost", true],
  ["gaps", "run.gaps", true], ["crc_errors", "run.crc", true]];

/** A card that is told the state of the page; `close` ends its drawing. */
export function healthCard() {
  const strip = h("div", { class: "strip" });
  const beam = tile(t("run.beam"));
  const distance = tile(t("run.distance"));
  const beside = tile(t("run.beside"));
  const control = tile(t("run.control"));
  const counts = COUNTS.map(([key, name, isBad]) => ({ key, isBad, ...tile(t(name)) }));
  const unwatched = h("p", { class: "no-watchdog", "data-tone": "fault", hidden: true }, t("connect.no_watchdog"));
  const caption = h("figcaption");
  const means = h("p", { class: "scope-means" });
  const air = h("dl", { class: "air" });
  const element = h("section", { class: "card stream" },
    h("h2", {}, t("run.health")),
    h("dl", { class: "tiles is-now" }, [beam, distance, beside, control].map((one) => one.element)),
    h("figure", { class: "scope" },
      caption, strip),
    h("dl", { class: "tiles is-counts" }, counts.map((one) => one.element)),
    means, air, unwatched);
  let chart = null;
  let live = null;
  let heard_ms = null;
  let lost_ms = null;
  let turned = null;

  function take(next, state) {
    const { machine, plan } = state;
    const rotary = (plan?.axes ?? []).map((name) => machine?.axes?.[name]?.type === "rotary");
    const now = (next.axes ?? []).filter((_, i) => rotary[i]).join();
    const isCurved = turned !== null && now !== turned;
    [live, heard_ms, turned] = [next, performance.now(), now];
    addPoints(chart, live, { isCurved, commanded: commandedNow(state) });
  }

  function showNow(job) {
    lost_ms = job.error?.code === "beam-lost" ? lost_ms ?? performance.now() : null;
    const state = beamOf(job, heard_ms, lost_ms);
    write(beam.number, t(`beam.${state}`));
    mark(beam.element, "data-tone", state === "lost" || state === "silent" ? "fault" : null);
    const point = live?.tracker_mm?.at(-1);
    write(distance.number, point && state === "seen" ? quantity(Math.hypot(...point), "distance", 3) : "–");
    const newest = state === "seen" ? chart.newest() : null;
    write(beside.number, newest === null ? "–" : `${number(newest, decimalsOf("error"))} ${unitOf("error")}`);
    const fault = OF_CONTROL.test(job.error?.code ?? "") ? wordProblem(job.error).title : null;
    write(control.number, fault ?? wordOf(job.state));
    mark(control.element, "data-tone", fault ? "fault" : null);
  }

  /** From which line the points are told. */
  function showMeaning(line) {
    if (means.dataset.line === line) return;
    means.dataset.line = line;
    caption.textContent = t(`run.scope_${line}`, { unit: unitOf("error") });
    means.textContent = t(`run.scope_means_${line}`);
  }

  return {
    element,
    update(state) {
      const { job, machine } = state;
      chart ??= drawStrip(strip);
      if (state.live && state.live !== live) take(state.live, state);
      showNow(job);
      showMeaning(chart.isCommanded() ? "commanded" : "fitted");
      unwatched.hidden = machine?.motion?.has_watchdog !== false;
      for (const { key, isBad, number: place, element: shown } of counts) {
        write(place, number(job.health?.[key]));
        mark(shown, "data-tone", isBad && job.health?.[key] > 0 ? "fault" : null);
      }
      showAir(air, live?.environment);
    },
    close: () => chart?.close(),
  };
}

/** Events carry the time of their last point only. */
function addPoints(chart, { tracker_mm: points = [], device_time_s: end_s = 0 }, way) {
  points.forEach((point, i) => chart.add(end_s - (points.length - 1 - i) * SPACING_S, point, way));
}

/** Where the ends of the line under way and of its neighbours should be seen; null while unknown. */
function commandedNow({ job, estimate }) {
  const { done, total, unit } = job.progress ?? {};
  if (unit !== "lines" || !estimate?.commanded || estimate.is_last) return null;
  const { first_row, tracker_mm } = estimate.commanded;
  const row = Math.floor(done) - first_row;
  const places = [row - 1, row, row + 1, row + 2].map((each) => tracker_mm[each]);
  const isKnown = places[1] && (places[2] || (places[0] && done >= total));
  return isKnown ? places.filter(Boolean) : null;
}

/** Whether the tracker sees its target: `seen`, `lost`, `silent` (no point for a while) or `unknown`.
 *
 * Only points that the tracker has seen are told: those that come after a loss say that it sees again.
 */
function beamOf(job, heard_ms, lost_ms) {
  const isSilent = heard_ms === null || performance.now() - heard_ms > SILENT_MS;
  if (lost_ms !== null) return isSilent || heard_ms - lost_ms < UNDER_WAY_MS ? "lost" : "seen";
  if (!isMoving(job) || heard_ms === null) return "unknown";
  return isSilent ? "silent" : "seen";
}

const UNITS = { degC: ["°C", 2], hPa: ["hPa", 1], percent: ["%", 0] };

/** The newest reading of each sensor, by its name and unit: X_degC, pressure_hPa. */
function showAir(list, readings) {
  const entries = Object.entries(readings ?? {});
  list.hidden = !entries.length;
  const key = JSON.stringify(entries);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...entries.map(([channel, value]) => {
    const [name, unit] = channel.split(/_(?=[^_]+$)/);
    const [sign, digits] = UNITS[unit] ?? [unit, 2];
    return h("div", {}, h("dt", {}, known(`sensor.${name}`, name)), h("dd", {}, `${number(value, digits)} ${sign}`));
  }));
}
