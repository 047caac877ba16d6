/* The step Connect: tracker and machine control answer, and are the ones expected. */
import { h, icon, mark, s } from "../dom.js";
import { addressOf, isActive, isConnected, machineName } from "../flow.js";
import { card, head, notice, pairs } from "../parts.js";
import { wordProblem } from "../problems.js";
import { dateTime, known, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";
import { conditionsCard } from "./conditions-card.js";
import { deviceCard } from "./device-card.js";
import { dropZone } from "./drop.js";

/** Button that leads on. */
export function lead({ machine, busy, job }, { actions, go }) {
  if (isActive(job)) {
    return { next: { key: "show", label: t("connect.show_job"), run: () => go(addressOf(job)) } };
  }
  if (busy === "connect") {
    return { next: { key: "connecting", label: t("connect.connecting"), disabled: true },
      reason: t("connect.connecting_reason") };
  }
  if (!isConnected(machine)) {
    const none = !machine?.axes;
    return { next: { key: "connect", label: t("connect.next"), disabled: none, run: actions.connect },
      reason: none ? t("connect.no_machine") : "" };
  }
  return { next: { key: "plan", label: t("connect.to_plan"), run: () => go("#/plan") } };
}

/** Show devices and machine. */
export function mount(root, { store, actions }) {
  const tracker = device("tracker", t("connect.tracker"));
  const control = device("controller", t("connect.control"));
  const thermometers = device("thermometer", t("connect.thermometers"));
  const machineCard = h("section", { class: "card" });
  const sensorsCard = h("section", { class: "card", "data-card": "sensors" });
  const devices = deviceCard({ actions });
  const lastError = lastErrorCard(actions.forgetDeviceError);
  const held = h("div");
  let conditions = null; // asked for once somebody can answer
  root.append(
    head(t("connect.title"), t("connect.text")),
    h("div", { class: "columns" },
      h("div", { class: "stack" }, lastError.element, tracker.element, control.element,
        thermometers.element, sensorsCard,
        card(t("connect.recorded"), dropZone(store, actions)), devices.element),
      h("div", { class: "stack" }, machineCard, held)),
  );
  let described = null;
  return {
    update(state) {
      const { machine } = state;
      devices.update(state);
      lastError.update(state);
      if (!conditions && isConnected(machine)) {
        conditions = conditionsCard(store);
        held.append(conditions.element);
      }
      conditions?.update(state);
      tracker.update(machine?.tracker, isConnected(machine));
      control.update(machine?.motion, isConnected(machine));
      thermometers.update(machine?.thermometers, isConnected(machine));
      thermometers.element.hidden = !machine?.thermometers;
      if (machine === described) return;
      described = machine;
      sensorsCard.hidden = !machine?.sensors?.length && !machine?.sensors_refused;
      sensorsCard.replaceChildren(...(sensorsCard.hidden ? [] : describeSensors(machine)));
      machineCard.replaceChildren(...describe(machine, machineName(state)));
    },
    close() {
      conditions?.close();
    },
  };
}

function device(shape, name) {
  const link = h("span", { class: "link" });
  const rows = h("dl", { class: "device-facts" });
  const model = h("p", { class: "quiet" });
  const element = h("section", { class: "card device" },
    h("div", { class: "device-icon" }, icon(shape)), h("h2", {}, name), link, model, rows);
  let shownIdentity;
  return {
    element,
    update(identity, connected) {
      const key = JSON.stringify([identity, connected]);
      if (key === shownIdentity) return;
      shownIdentity = key;
      mark(element, "data-connected", Boolean(identity && connected));
      link.replaceChildren(...(identity && connected
        ? [icon("check"), t("connect.connected")] : [t("connect.not_connected")]));
      model.textContent = identity ? `${identity.maker} ${identity.model}`.trim() : t("connect.unknown");
      rows.replaceChildren(...(identity ? [
        fact(t("connect.serial"), identity.serial_number),
        fact(t("connect.firmware"), identity.firmware),
        ...(shape === "controller" ? [watchdogFact(identity)] : []),
      ] : []));
    },
  };
}

/** What every sensor shows by each way to read it: the one that is set, and the one that seems right. */
function describeSensors({ sensors, sensors_refused: refused }) {
  const words = ({ value, is_set: isSet, is_likely: isLikely }) => [Math.abs(value) < 1e6 ? number(value, 2) : value.toExponential(0),
    isSet && t("connect.way_set"), isLikely ? t("connect.way_likely") : isSet && t("connect.way_unlikely")].filter(Boolean).join(" · ");
  return [h("h2", {}, t("connect.sensors")), refused && notice("fault", t("connect.sensors_refused"), refused),
    pairs(sensors.map((way) => [wordWay(way), words(way)]))].filter(Boolean);
}

/** A way to read a sensor: "Air: register 100, word order big". */
function wordWay({ channel, how }) {
  const name = channel.slice(0, channel.lastIndexOf("_"));
  const way = how.replace(/(\w+) = "?(\w+)"?/g, (_, key, value) => `${known(`sensor.way.${key}`, key)} ${value}`);
  return `${known(`sensor.${name}`, name)}: ${way}`;
}

function watchdogFact({ has_watchdog: has }) {
  const row = fact(t("connect.watchdog"), t(has ? "connect.has_watchdog" : "connect.no_watchdog"));
  mark(row, "data-tone", has ? null : "fault");
  return row;
}

const fact = (name, value) => h("div", {}, h("dt", {}, name), h("dd", {}, value || "–"));

function describe(machine, name) {
  const title = h("h2", {}, t("connect.machine"));
  if (!machine?.axes) return [title, h("p", { class: "empty" }, t("connect.no_machine"))];
  return [title, volume(machine), pairs(facts(machine, name))];
}

function facts(machine, name) {
  const travel = Object.entries(machine.axes).map(([name, axis]) => [
    t("connect.travel", { axis: name }),
    axis.type === "rotary"
      ? `${number(axis.min_deg)} … ${number(axis.max_deg)} °`
      : `${figure(axis.min_mm, "travel")} … ${quantity(axis.max_mm, "travel")}`,
  ]);
  const rows = [[t("connect.name"), name], [t("connect.chain"), machine.kinematic_chain], ...travel];
  if (machine.tool_offset_mm) {
    const offset = machine.tool_offset_mm.map((v) => figure(v, "travel", 1)).join("   ");
    rows.push([t("connect.offset"), `${offset} ${unitOf("travel")}`]);
  }
  if (machine.site) rows.push([t("machine.altitude"), `${number(machine.site.altitude_m)} m`]);
  const rate_hz = machine.tracker_noise?.rate_hz;
  if (rate_hz) rows.push([t("connect.rate"), `${number(rate_hz)} Hz`]);
  return rows;
}

const CORNERS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];
const SEEN = [[0, 1], [1, 2], [0, 4], [1, 5], [2, 6], [4, 5], [5, 6], [6, 7], [7, 4]];
const BEHIND = [[0, 3], [2, 3], [3, 7]];

/** The axis travel as a box in oblique view, its edges named. */
function volume(machine) {
  const size = ["X", "Y", "Z"].map((name) => {
    const axis = machine.axes[name];
    return axis?.max_mm === undefined ? 0 : axis.max_mm - axis.min_mm;
  });
  const project = ([x, y, z]) => {
    const [a, b, c] = [x * size[0], y * size[1], z * size[2]];
    return [a * 0.87 + b * 0.52, -c + a * 0.2 - b * 0.34];
  };
  const points = CORNERS.map(project);
  const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const box = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  const factor = Math.min(320 / (box[2] - box[0] || 1), 160 / (box[3] - box[1] || 1));
  const margin = (500 - (box[2] - box[0]) * factor) / 2;
  const at = (i) => [(points[i][0] - box[0]) * factor + margin, (points[i][1] - box[1]) * factor + 20];
  const path = (ids) => `M${ids.map((i) => at(i).map((v) => v.toFixed(1)).join(" ")).join("L")}`;
  const label = (i, j, dx, dy, name, k, anchor) => {
    const [a, b] = [at(i), at(j)];
    return s("text", { x: (a[0] + b[0]) / 2 + dx, y: (a[1] + b[1]) / 2 + dy, "text-anchor": anchor },
      `${name} ${quantity(size[k], "travel")}`);
  };
  const height = (box[3] - box[1]) * factor + 52;
  return s("svg", { class: "volume", viewBox: `0 0 500 ${height.toFixed(0)}`, role: "img",
    "aria-label": t("connect.volume") },
  s("path", { class: "face", d: `${path([0, 1, 5, 4])}Z` }),
  BEHIND.map((edge) => s("path", { class: "hidden-edge", d: path(edge) })),
  SEEN.map((edge) => s("path", { d: path(edge) })),
  label(0, 1, -6, 22, "X", 0, "middle"), label(1, 2, 10, 16, "Y", 1, "start"),
  label(0, 4, -10, 4, "Z", 2, "end"));
}

/** The card; it stays until the devices answer again or somebody takes it away. */
function lastErrorCard(forget) {
  const body = h("div");
  const element = h("section", { class: "card", "data-card": "last-error", hidden: true },
    h("h2", {}, t("connect.last_error")), body,
    h("button", { class: "button below", onclick: forget }, t("connect.forget_error")));
  let shown = null;
  return {
    element,
    update({ deviceError: error }) {
      if (error === shown) return;
      shown = error;
      element.hidden = !error;
      if (!error) return;
      const { title, text, action } = wordProblem(error.problem);
      body.replaceChildren(h("p", { class: "quiet" }, dateTime(error.at)), notice("held", title, text, action));
    },
  };
}
