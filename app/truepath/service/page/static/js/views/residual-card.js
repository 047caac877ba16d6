/* What the model leaves of the measurement: by line, along a line, as a distribution. */
import { h, mark, s, write } from "../dom.js";
import { segments } from "../parts.js";
import { number, t } from "../texts.js";
import { quantity, shown, unitOf } from "../units.js";

const PARTS = [["beam", "trace-x"], ["azimuth", "trace-y"], ["elevation", "trace-z"]];
const BINS = 41;
const WIDEST = 5; // of the distribution, in root mean squares

/** The card; null where the result says nothing by line. `close` ends it. */
export function residualCard(result) {
  const { by_line: rows, noise_floor_um: floor } = result.residuals ?? {};
  if (!rows?.length) return null;
  const cells = (result.runs ?? []).flatMap((run) => run.residuals?.along_lines ?? []);
  const lines = cells.filter(({ along_mm }) => Math.max(...along_mm) > 0);
  const unit = t(result.mode === "standstill" ? "residual.point" : "residual.line");
  const shownNow = { view: "by_line", line: 0 };
  const plot = h("div", { class: "residual-plot", role: "img" });
  const key = h("ul", { class: "key" });
  const note = h("p", { class: "quiet" });
  const pick = h("input", { id: "residual-line", class: "slider", type: "range", min: 0, max: Math.max(0, lines.length - 1), step: 1, value: 0 });
  const read = h("output", { for: "residual-line" });
  const field = h("div", { class: "slider-field" }, h("label", { for: "residual-line" }, t("residual.which")), read, pick);
  pick.addEventListener("input", () => show({ line: Number(pick.value) }));
  const views = [["by_line", t("residual.by_line")], lines.length && ["along", t("residual.along")], cells.length && ["spread", t("residual.spread")]].filter(Boolean);
  const scenes = { by_line: () => byLine(rows, floor, unit), along: () => along(lines, shownNow.line), spread: () => spread(cells, floor) };
  let chart = null;

  function show(change) {
    Object.assign(shownNow, change);
    const { view, line } = shownNow;
    const scene = scenes[view]();
    mark(plot, "aria-label", scene.spoken);
    write(note, scene.note);
    key.replaceChildren(...scene.key);
    field.hidden = view !== "along";
    if (view === "along") {
      const name = t("residual.line_number", { row: number(lines[line].row + 1) });
      write(read, name);
      mark(pick, "aria-valuetext", name);
    }
    if (chart) chart.update(scene);
    else chart = drawChart(plot, scene);
  }

  const element = h("section", { class: "card stack", "data-card": "residuals" },
    h("div", { class: "card-head" }, h("h2", {}, t("residual.title")), views.length > 1 && segments(t("residual.title"), views, shownNow.view, (view) => show({ view }), true)),
    plot, key, field, note);
  show({});
  return { element, close: () => chart?.close() };
}

const entry = (name, text) => h("li", { class: `is-${name}` }, h("i"), text);

const values = (line, part) => line[`${part}_um`].map((v) => shown(v, "gap"));

/** Root mean square of each line, against what noise alone leaves. */
function byLine(rows, floor_um, unit) {
  const heights = rows.map((row) => shown(row.rms_um, "gap"));
  const floor = floor_um === undefined ? null : shown(floor_um, "gap");
  const top = 1.12 * Math.max(...heights, floor ?? 0);
  const worst = rows.reduce((best, row) => (row.rms_um > best.rms_um ? row : best));
  // Rows of several Runs repeat: they are counted instead.
  const places = rows.every((row) => row.run === rows[0].run) ? rows.map((row) => row.row + 1) : rows.map((_, i) => i + 1);
  const [first, last] = [places[0], places.at(-1)];
  return {
    x: [first - 0.6, last + 0.6], y: [0, top], names: [unit, t("residual.rms_axis", { unit: unitOf("gap") })], xTicks: thinned(first, last),
    marks: ({ x, y, left, right, bottom }) => [
      ...heights.map((v, i) => s("rect", { class: "column", x: x(places[i] - 0.35), width: Math.max(1, x(1.7) - x(1)), y: y(v), height: bottom - y(v) })),
      floor !== null && s("line", { class: "level", x1: left, x2: right, y1: y(floor), y2: y(floor) })],
    key: [entry("column", t("residual.rms")), floor !== null && entry("level", t("residual.floor"))].filter(Boolean),
    note: t("residual.worst", { row: number(worst.row + 1), rms: quantity(worst.rms_um, "gap") }),
    spoken: t("residual.worst", { row: number(worst.row + 1), rms: quantity(worst.rms_um, "gap") }),
  };
}

function thinned(first, last) {
  const step = [1, 2, 5, 10, 20, 50, 100, 200].find((one) => (last - first) / one <= 14) ?? 500;
  const begin = Math.ceil(first / step);
  return Array.from({ length: Math.floor(last / step) - begin + 1 }, (_, i) => (begin + i) * step);
}

/** The residual's three parts along one line. */
function along(lines, index) {
  const line = lines[index];
  const way = line.along_mm.map((v) => shown(v, "length"));
  const reach = 1.1 * Math.max(...lines.flatMap((one) => PARTS.flatMap(([part]) => one[`${part}_um`].map((v) => Math.abs(shown(v, "gap"))))));
  return {
    x: [0, Math.max(...way, 1e-6)], y: [-reach, reach], names: [t("residual.way", { unit: unitOf("length") }), t("residual.axis", { unit: unitOf("gap") })],
    marks: ({ x, y }) => PARTS.map(([part, tone]) => s("path", { class: `trace is-${tone}`,
      d: `M${values(line, part).map((v, i) => `${x(way[i])} ${y(v)}`).join("L")}` })),
    key: PARTS.map(([part, tone]) => entry(tone, t(`residual.${part}`))),
    note: t("residual.same_scale"), spoken: t("residual.line_number", { row: number(line.row + 1) }),
  };
}

/** How often residuals of each size occur, against noise alone. */
function spread(cells, floor_um) {
  const all = PARTS.map(([part]) => cells.flatMap((line) => values(line, part)));
  const count = all[0].length;
  const rms = Math.sqrt(all.flat().reduce((sum, v) => sum + v * v, 0) / (3 * count));
  const reach = WIDEST * rms || 1;
  const step = (2 * reach) / BINS;
  const shares = all.map((own) => histogram(own, reach, step));
  const sigma = floor_um ? shown(floor_um, "gap") : rms;
  const normal = (v) => (100 * step * Math.exp(-0.5 * (v / sigma) ** 2)) / (sigma * Math.sqrt(2 * Math.PI));
  const fine = Array.from({ length: 161 }, (_, i) => -reach + (2 * reach * i) / 160);
  const top = 1.1 * Math.max(...shares.flat(), normal(0));
  const steps = ({ x, y }, own) => `M${own.map((v, i) => `${x(-reach + i * step)} ${y(v)}H${x(-reach + (i + 1) * step)}`).join("L")}`;
  const outside = all.flat().filter((v) => Math.abs(v) > reach).length;
  return {
    x: [-reach, reach], y: [0, top], names: [t("residual.axis", { unit: unitOf("gap") }), t("residual.share")],
    marks: (frame) => [s("path", { class: "level", d: `M${fine.map((v) => `${frame.x(v)} ${frame.y(normal(v))}`).join("L")}` }),
      ...PARTS.map(([, tone], i) => s("path", { class: `trace is-${tone}`, d: steps(frame, shares[i]) }))],
    key: [...PARTS.map(([part, tone]) => entry(tone, t(`residual.${part}`))), entry("level", t("residual.noise_alone"))],
    note: outside ? t("residual.outside", { count: number(outside), total: number(3 * count) }) : t("residual.cells", { count: number(count) }),
    spoken: t("residual.spread"),
  };
}

function histogram(own, reach, step) {
  const counts = Array(BINS).fill(0);
  for (const v of own) {
    const bin = Math.floor((v + reach) / step);
    if (bin >= 0 && bin < BINS) counts[bin] += 1;
  }
  return counts.map((n) => (100 * n) / own.length);
}

const MARGIN = { left: 64, right: 20, top: 14, bottom: 52 };

/** Draw in an element; answers {update, close}.
 *
 * scene: {x: [low, high], y: [low, high], names: [x, y], marks(frame): elements, xTicks: places or null}
 */
function drawChart(element, first) {
  let scene = first;
  const svg = s("svg", { class: "svg-chart", "aria-hidden": "true" });
  element.replaceChildren(svg);

  function draw() {
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width || !height) return;
    for (const [name, value] of [["width", width], ["height", height], ["viewBox", `0 0 ${width} ${height}`]]) mark(svg, name, value);
    const frame = frameOf(scene, width, height);
    svg.replaceChildren(...grid(scene, frame), ...[scene.marks(frame)].flat(Infinity).filter(Boolean), ...names(scene, frame));
  }

  const watcher = new ResizeObserver(draw);
  watcher.observe(element);
  return {
    update(next) {
      scene = next;
      draw();
    },
    close: () => watcher.disconnect(),
  };
}

function frameOf({ x: [x0, x1], y: [y0, y1] }, width, height) {
  const [left, right, top, bottom] = [MARGIN.left, width - MARGIN.right, MARGIN.top, height - MARGIN.bottom];
  return { left, right, top, bottom, x: (v) => left + ((right - left) * (v - x0)) / (x1 - x0 || 1),
    y: (v) => bottom - ((bottom - top) * (v - y0)) / (y1 - y0 || 1) };
}

function grid({ x, y, xTicks = null }, frame) {
  const columns = xTicks ?? ticksOf(x, 7);
  const rows = ticksOf(y, 5);
  const text = (marks) => (v) => number(v, digitsOf(marks));
  return [
    ...rows.map((v) => s("line", { class: "grid", x1: frame.left, x2: frame.right, y1: frame.y(v), y2: frame.y(v) })),
    s("line", { class: "base", x1: frame.left, x2: frame.right, y1: frame.bottom, y2: frame.bottom }),
    ...rows.map((v) => s("text", { x: frame.left - 8, y: frame.y(v) + 4, "text-anchor": "end" }, text(rows)(v))),
    ...columns.map((v) => s("text", { x: frame.x(v), y: frame.bottom + 20, "text-anchor": "middle" }, text(columns)(v))),
  ];
}

function names({ names: [across, up] }, { left, right, top, bottom }) {
  const [x, y] = [0.5 * (left + right), 0.5 * (top + bottom)];
  return [s("text", { class: "axis", x, y: bottom + 43, "text-anchor": "middle" }, across),
    s("text", { class: "axis", x: 15, y, "text-anchor": "middle", transform: `rotate(-90 15 ${y})` }, up)];
}

/** Round places in a range, about so many. */
function ticksOf([low, high], count) {
  const rough = (high - low || 1) / count;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = decade * [1, 2, 5, 10].find((one) => one * decade >= rough);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}

function digitsOf(marks) {
  const step = marks.length > 1 ? Math.abs(marks[1] - marks[0]) : 1;
  return step >= 1 ? 0 : Math.ceil(-Math.log10(step) - 1e-9);
}
