/* The volumetric error in the volume: arrows in space or in a plane, before and after compensation. */
import * as api from "../api.js";
import { h, mark, write } from "../dom.js";
import { problemNotice, segments, tableFrame, wordFormat } from "../parts.js";
import { COVERAGE, roundReach } from "../plots/error-chart.js";
import { lengthScale, scaleKey } from "../plots/length-scale.js";
import { drawSlice, PLANES } from "../plots/map-slice.js";
import { drawVolume } from "../plots/map-volume.js";
import { VIEWS } from "../plots/scene.js";
import { prefer, preference } from "../preferences.js";
import { dateTime, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";

const LINEAR = ["X", "Y", "Z"];
const [VOLUME, PLACES] = ["volume", "places"];
const [FACTOR_STEPS, DECADE] = [60, 15]; // of the slider
const LONGEST = 0.12; // of the travel's diagonal, the largest arrow at first

/** The card, with what kept files leave and what a verification has measured.
 *
 * proof: promise of the newest verification of the result, or null; did(step): hears which steps were done for it
 * `addOther(job, result)` offers another calibration, `close` ends it
 */
export function mapCard(job, result, proof, did) {
  const shown = { state: "before", view: VOLUME, level: null, factor: null, map: null, first: null, scale: null };
  const maps = new Map();
  const others = new Map();
  let places = null;
  const parts = build();
  let volume = null;
  let slice = null;
  let due = null;
  let closed = false;

  const states = choose(t("map.state"), [["before", t("map.before")], ["after", t("map.after")]], shown.state, show);
  const views = choose(t("map.view"), [[VOLUME, t("map.volume")], ...Object.keys(PLANES).map((plane) => [plane, plane])],
    shown.view, (view) => {
      shown.view = view;
      draw();
    });
  parts.tools.append(states, views);
  parts.scales.append(choose(t("result.scale"), [["common", t("map.scale_common")], ["own", t("map.scale_own")]], preference("scale"), (value) => {
    prefer("scale", value);
    if (shown.map) rescale();
  }));
  parts.factor.addEventListener("input", () => {
    shown.factor = factorAt(Number(parts.factor.value));
    drawSoon();
  });
  parts.level.addEventListener("input", () => {
    shown.level = Number(parts.level.value);
    drawSoon();
  });
  show(shown.state);
  // Without the list there are two states: they stand all the same.
  api.compensations(job.id).then(addKept, () => {}).then(() => proof).then(addPlaces);

  function add(state, text) {
    if (!states.querySelector(`[data-value="${CSS.escape(state)}"]`)) states.add(state, text);
  }

  function addKept(kept) {
    if (kept.length) did("export");
    for (const { id, format, control } of kept) add(id, t("map.with_files", { control: wordFormat(format, "control", control) }));
  }

  /** Offer what a verification has measured at standstill; on lines one direction is open. */
  function addPlaces(verified) {
    if (verified) did("verify");
    if (!verified?.verification.places.standstill.some(Boolean)) return;
    places = verified.verification;
    add(PLACES, t(places.compensated ? "map.left" : "map.again"));
  }

  /** Offer what another calibration has measured, such as the one after the tables were loaded. */
  function addOther(other, found) {
    others.set(other.id, found);
    add(other.id, t("map.other", { when: dateTime(other.ended ?? other.created) }));
  }

  async function load(state) {
    if (state === PLACES) return readPlaces(places, maps.get("before") ?? await load("before"));
    const other = others.get(state);
    return other ? readMap(await api.volumetricMap(state, "before"), other) : readMap(await api.volumetricMap(job.id, state), result);
  }

  /** Fetch a state once, then draw it; a later choice makes an earlier one void. */
  async function show(state) {
    shown.state = state;
    try {
      if (!maps.has(state)) maps.set(state, await load(state));
    } catch (error) {
      api.expectProblem(error);
      if (shown.state === state && !closed) fail(error);
      return;
    }
    if (shown.state !== state || closed) return;
    shown.map = maps.get(state);
    shown.first ??= shown.map;
    shown.factor ??= firstFactor(shown.map);
    rescale();
  }

  /** One scale for all states shows what compensation takes away; one of its own, what is left. */
  function rescale() {
    const { map, first } = shown;
    const { points } = preference("scale") === "common" ? first : map;
    shown.scale = lengthScale(points.map((p) => p.length_um));
    draw(true);
  }

  function fail(problem) {
    parts.picture.replaceChildren(problemNotice(problem));
  }

  /** A slider tells more often than there are frames. */
  function drawSoon() {
    due ??= requestAnimationFrame(() => {
      due = null;
      if (!closed) draw();
    });
  }

  function draw(isOther = false) {
    const { map, view } = shown;
    if (!map) return;
    const isVolume = view === VOLUME;
    parts.volume.hidden = !isVolume;
    parts.slice.hidden = isVolume;
    describe(isVolume);
    if (isVolume) drawInSpace(isOther);
    else drawPlane();
    if (isOther) parts.numbers.replaceChildren(mapTable(map));
  }

  async function drawInSpace(isOther) {
    const { map, scale, factor } = shown;
    if (!volume) {
      volume = drawVolume(parts.volume, map, scale, factor);
      const drawn = await volume;
      if (closed) drawn.close();
      parts.volume.dataset.drawn = "";
      return;
    }
    const drawn = await volume;
    if (isOther) drawn.update(map, scale);
    drawn.exaggerate(shown.factor);
  }

  function drawPlane() {
    const { map, scale, factor, view } = shown;
    const across = PLANES[view][2];
    const last = map.levels[across].length - 1;
    shown.level = Math.min(shown.level ?? Math.round(last / 2), last);
    mark(parts.level, "max", last);
    parts.level.value = shown.level;
    const place = `${LINEAR[across]} ${quantity(map.levels[across][shown.level], "travel")}`;
    write(parts.levelRead, place);
    mark(parts.level, "aria-valuetext", place);
    const wanted = { map, scale, factor, plane: view, level: shown.level };
    if (slice) slice.update(wanted);
    else slice = drawSlice(parts.slice, wanted);
  }

  function describe(isVolume) {
    const { map, scale, factor } = shown;
    parts.cameras.hidden = !isVolume;
    parts.levelField.hidden = isVolume || map.isScattered;
    parts.key.replaceChildren(scaleKey(scale));
    parts.factor.value = stepOf(factor);
    const times = t("map.times", { factor: number(factor) });
    write(parts.factorRead, times);
    mark(parts.factor, "aria-valuetext", times);
    parts.factorField.hidden = !map.hasDirection;
    write(parts.note, noteOf(map, isVolume));
    for (const element of [parts.volume, parts.slice]) mark(element, "aria-label", spoken(map));
  }

  parts.cameras.append(segments(t("path.view"), VIEWS.map((name) => [name, t(`path.${name}`)]), "iso",
    async (name) => (await volume)?.view(name), true));

  return {
    element: parts.element,
    addOther,
    close() {
      closed = true;
      slice?.close();
      volume?.then((drawn) => drawn.close());
    },
  };
}

function build() {
  const picture = (name) => h("div", { class: `map-picture is-${name}`, role: "img", hidden: true });
  const range = (id, label, max) => {
    const input = h("input", { id, type: "range", min: 0, max, step: 1, class: "slider" });
    const read = h("output", { for: id });
    return [input, read, h("div", { class: "slider-field" }, h("label", { for: id }, label), read, input)];
  };
  const [factor, factorRead, factorField] = range("map-factor", t("map.exaggeration"), FACTOR_STEPS);
  const [level, levelRead, levelField] = range("map-level", t("map.level"), 1);
  const [volume, slice] = ["volume", "slice"].map(picture);
  const tools = h("div", { class: "map-tools" });
  const cameras = h("div", { class: "map-cameras" });
  const key = h("div", { class: "map-key" });
  const scales = h("div", { class: "map-scales" });
  const note = h("p", { class: "quiet" });
  const numbers = h("div", { class: "map-numbers" });
  const frame = h("div", { class: "map-frame" }, volume, slice, cameras);
  const element = h("section", { class: "card map-card", "data-card": "map", "aria-label": t("map.title") },
    h("h2", { class: "unseen" }, t("map.title")), tools, frame, key,
    h("div", { class: "map-under" }, scales, factorField, levelField), note, numbers);
  return { element, picture: frame, volume, slice, tools, cameras, key, scales, note, numbers, factor, factorRead, factorField,
    level, levelRead, levelField };
}

/** Segments to which one may be added. */
function choose(label, options, chosen, pick) {
  const group = segments(label, options, chosen, pick, true);
  group.add = (value, text) => {
    const more = segments(label, [...[...group.children].map((b) => [b.dataset.value, b.textContent]), [value, text]],
      [...group.children].find((b) => b.getAttribute("aria-pressed") === "true")?.dataset.value, pick, true);
    group.replaceChildren(...more.children);
  };
  return group;
}

/** The largest arrow is to be seen, and not to leave its surroundings. */
function firstFactor({ travel, points }) {
  const diagonal = Math.hypot(...travel.map(([low, high]) => high - low));
  const largest = Math.max(...points.map((p) => p.length_um), 1e-3);
  return factorAt(stepOf((1000 * LONGEST * diagonal) / largest));
}

/** Round factors from 100 to 1 000 000 in steps of the slider. */
const factorAt = (step) => roundReach(10 ** (2 + step / DECADE));
const stepOf = (factor) => Math.max(0, Math.min(FACTOR_STEPS, Math.round(DECADE * (Math.log10(factor) - 2))));

function noteOf(map, isVolume) {
  if (map.isScattered) return t(isVolume ? "map.note_places" : "map.note_places_plane", { count: number(map.points.length) });
  const parts = [map.hasDirection ? t(isVolume ? "map.note_volume" : "map.note_plane") : t("map.note_left")];
  if (map.points.some((p) => !p.isMeasured)) parts.push(t("map.note_open"));
  else if (!isVolume && map.measured.some(Boolean)) parts.push(t("map.note_hatched"));
  return parts.join(" ");
}

function spoken({ points }) {
  const largest = points.reduce((best, p) => (p.length_um > best.length_um ? p : best));
  const mean = points.reduce((sum, p) => sum + p.length_um, 0) / points.length;
  return t("map.spoken", { mean: quantity(mean, "gap"), largest: quantity(largest.length_um, "gap"),
    place: largest.at_mm.map((v, i) => `${LINEAR[i]} ${quantity(v, "travel")}`).join(", ") });
}

/** A map of the service for drawing; `result` says which range was measured.
 *
 * columns: those of X, Y and Z in a position
 * points: [{index, at_mm, error_um, expanded_um, length_um, isMeasured}, …]
 */
function readMap(found, result) {
  const columns = LINEAR.map((name) => found.axes.indexOf(name));
  const pick = (row) => columns.map((c) => row[c]);
  const places = found.position.map(pick);
  const levels = columns.map((_, i) => [...new Set(places.map((at) => at[i]))].sort((a, b) => a - b));
  return {
    columns, count: found.points, isScattered: false, levels, hasDirection: found.error_um.some((error) => error.some(Boolean)),
    travel: levels.map((own) => [own[0], own.at(-1)]),
    measured: LINEAR.map((name) => rangeOf(result.measured_range?.[name])),
    points: places.map((at_mm, i) => ({
      at_mm, index: at_mm.map((v, k) => levels[k].indexOf(v)),
      error_um: found.error_um[i], expanded_um: found.uncertainty_um[i].map((u) => COVERAGE * u),
      length_um: found.length_um[i], isMeasured: found.is_measured[i],
    })),
  };
}

const rangeOf = (range) => (range ? [range.from_mm, range.to_mm] : null);

/** What a verification has measured where the machine stood still, in the travel of a map; the places lie on no grid. */
function readPlaces({ places }, map) {
  const points = places.position.map((position, i) => ({
    at_mm: map.columns.map((c) => position[c]), error_um: places.measured_um[i],
    expanded_um: places.measured_uncertainty_um[i].map((u) => COVERAGE * u),
    length_um: Math.hypot(...places.measured_um[i]), isMeasured: true,
  }));
  return { ...map, isScattered: true, hasDirection: true, points: points.filter((_, i) => places.standstill[i]) };
}

/** A table that is written when it is opened. */
function mapTable(map) {
  const content = tableFrame(t("map.table"));
  const details = h("details", { class: "map-table" }, h("summary", {}, t("map.table")), content);
  details.addEventListener("toggle", () => {
    if (details.open && !content.children.length) content.append(table(map));
  });
  return details;
}

function table({ points, levels, hasDirection, isScattered }) {
  const kept = levels.map((own) => new Set([0, Math.floor((own.length - 1) / 2), own.length - 1]));
  const rows = isScattered ? points : points.filter(({ index }) => index.every((i, k) => kept[k].has(i)));
  const title = (text) => h("th", { class: "right", scope: "col" }, text);
  const micro = unitOf("gap");
  return h("table", {},
    h("thead", {}, h("tr", {}, ["X", "Y", "Z"].map((name) => title(`${name} (${unitOf("travel")})`)),
      hasDirection && ["δx", "δy", "δz"].map((name) => title(`${name} ± U (${micro})`)), title(`${t("map.length")} (${micro})`),
      h("th", { scope: "col" }, t("map.range")))),
    h("tbody", {}, rows.map(({ at_mm, error_um, expanded_um, length_um, isMeasured }) => h("tr", {},
      at_mm.map((v) => h("td", { class: "right" }, figure(v, "travel"))),
      hasDirection && error_um.map((v, i) => h("td", { class: "right" }, `${figure(v, "gap")} ± ${figure(expanded_um[i], "gap")}`)),
      h("td", { class: "right" }, figure(length_um, "gap")),
      h("td", {}, t(isMeasured ? "map.measured" : "map.unmeasured"))))),
    h("caption", {}, t(isScattered ? "map.table_places" : "map.table_note", { k: COVERAGE })));
}
