/* Uncertainty against time as one curve with a handle: where it stands is what is chosen. */
import { mark, s } from "../dom.js";
import { number, t } from "../texts.js";
import { shown, unitOf } from "../units.js";
import { COVERAGE } from "./error-chart.js";

const MARGIN = { left: 62, right: 24, top: 18, bottom: 54 };
const DECADES = 1.6; // above the end of the curve: what is higher is cut off
const KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 4, PageDown: -4, Home: -Infinity, End: Infinity };

/** Draw a curve; answers {update, close}.
 *
 * points: [{time_s, expanded_volumetric_uncertainty_um}, …]; choose(i) hears where the handle was put
 * update(i, level_um, spoken): where it stands, a target or null, and what a screen reader says
 */
export function drawPlanCurve(element, points, choose) {
  let drawn = { at: points.length - 1, level_um: null, spoken: "" };
  let frame = null;
  const handle = s("g", { class: "handle", role: "slider", tabindex: "0", "aria-label": t("curve.handle"),
    "aria-valuemin": 1, "aria-valuemax": points.length }, s("line", {}), s("circle", { class: "handle-grip", r: 22 }), s("circle", { r: 11 }));
  const svg = s("svg", { class: "plan-curve" });
  element.replaceChildren(svg);
  const watcher = new ResizeObserver(draw);
  watcher.observe(element);
  handle.addEventListener("keydown", (event) => {
    if (!(event.key in KEYS)) return;
    event.preventDefault();
    put(drawn.at + KEYS[event.key]);
  });
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    handle.focus();
    follow(event);
  });
  svg.addEventListener("pointermove", (event) => {
    if (svg.hasPointerCapture(event.pointerId)) follow(event);
  });

  function put(at) {
    const wanted = Math.max(0, Math.min(points.length - 1, at));
    if (wanted !== drawn.at) choose(wanted);
  }

  function follow(event) {
    const x = event.clientX - svg.getBoundingClientRect().left;
    const far = points.map((p) => Math.abs(frame.x(p) - x));
    put(far.indexOf(Math.min(...far)));
  }

  function draw() {
    const [width, height] = [element.clientWidth, element.clientHeight];
    if (!width || !height) return;
    frame = scales(points, width, height);
    for (const [name, value] of [["width", width], ["height", height], ["viewBox", `0 0 ${width} ${height}`]]) mark(svg, name, value);
    const seen = points.filter((p) => frame.isSeen(p));
    const line = `M${seen.map((p) => `${frame.x(p)} ${frame.y(p)}`).join("L")}`;
    svg.replaceChildren(...axes(frame), s("path", { class: "rest", d: line }), s("path", { class: "taken", "data-taken": "" }),
      s("path", { class: "level", "data-level": "" }), handle);
    place();
  }

  function place() {
    const { at, level_um, spoken } = drawn;
    mark(handle, "aria-valuenow", at + 1);
    mark(handle, "aria-valuetext", spoken);
    if (!frame) return;
    const taken = points.slice(0, at + 1).filter((p) => frame.isSeen(p));
    const [x, y] = [frame.x(points[at]), frame.isSeen(points[at]) ? frame.y(points[at]) : frame.top];
    mark(svg.querySelector("[data-taken]"), "d", taken.length ? `M${taken.map((p) => `${frame.x(p)} ${frame.y(p)}`).join("L")}` : null);
    for (const circle of handle.querySelectorAll("circle")) for (const [name, value] of [["cx", x], ["cy", y]]) mark(circle, name, value);
    const rule = handle.querySelector("line");
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", y], ["y2", frame.bottom]]) mark(rule, name, value);
    const level = level_um === null ? null : frame.yOf(level_um);
    const isIn = level !== null && level >= frame.top && level <= frame.bottom;
    mark(svg.querySelector("[data-level]"), "d", isIn ? `M${frame.left} ${level}H${frame.right}` : null);
  }

  return {
    update(at, level_um, spoken) {
      drawn = { at, level_um, spoken };
      place();
    },
    close: () => watcher.disconnect(),
  };
}

function scales(points, width, height) {
  const last = points.at(-1);
  const low = Math.log10(last.expanded_volumetric_uncertainty_um) - 0.08;
  const high = Math.min(Math.log10(points[0].expanded_volumetric_uncertainty_um), low + DECADES);
  const [left, right, top, bottom] = [MARGIN.left, width - MARGIN.right, MARGIN.top, height - MARGIN.bottom];
  const xOf = (time_s) => left + ((right - left) * time_s) / last.time_s;
  const yOf = (um) => bottom - ((bottom - top) * (Math.log10(um) - low)) / (high - low);
  const isSeen = (p) => Math.log10(p.expanded_volumetric_uncertainty_um) <= high + 1e-9;
  return { left, right, top, bottom, low, high, longest_s: last.time_s, xOf, yOf, isSeen,
    x: (p) => xOf(p.time_s), y: (p) => yOf(p.expanded_volumetric_uncertainty_um) };
}

function axes(frame) {
  const { left, right, top, bottom, low, high, longest_s, xOf, yOf } = frame;
  const ticks = [-2, -1, 0, 1, 2, 3].flatMap((decade) => [1, 2, 5].map((step) => step * 10 ** decade))
    .map((tick) => [tick, tick / shown(1, "gap")]).filter(([, um]) => Math.log10(um) >= low && Math.log10(um) <= high);
  const step = [0.25, 0.5, 1, 2, 5, 10, 20].find((minutes) => longest_s / 60 / minutes <= 7) ?? 30;
  const minutes = Array.from({ length: Math.floor(longest_s / 60 / step + 1e-6) + 1 }, (_, i) => i * step);
  const digits = (value) => (value >= 1 ? 0 : value >= 0.1 ? 1 : 2);
  return [
    ...ticks.map(([, um]) => s("line", { class: "grid", x1: left, x2: right, y1: yOf(um), y2: yOf(um) })),
    s("line", { class: "base", x1: left, x2: right, y1: bottom, y2: bottom }),
    ...ticks.map(([tick, um]) => s("text", { x: left - 9, y: yOf(um) + 4, "text-anchor": "end" }, number(tick, digits(tick)))),
    ...minutes.map((m) => s("text", { x: xOf(60 * m), y: bottom + 20, "text-anchor": "middle" }, number(m, step < 1 ? (step === 0.25 ? 2 : 1) : 0))),
    s("text", { class: "axis", x: 0.5 * (left + right), y: bottom + 44, "text-anchor": "middle" }, t("curve.time")),
    s("text", { class: "axis", x: 16, y: 0.5 * (top + bottom), "text-anchor": "middle", transform: `rotate(-90 16 ${0.5 * (top + bottom)})` },
      t("curve.uncertainty", { unit: unitOf("gap"), k: COVERAGE })),
  ];
}
