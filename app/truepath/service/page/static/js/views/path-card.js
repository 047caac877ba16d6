/* The card with the path in space, as Check and Run show it. */
import { h, mark } from "../dom.js";
import { segments } from "../parts.js";
import { drawPath } from "../plots/job-path.js";
import { VIEWS } from "../plots/scene.js";
import { t } from "../texts.js";

/** A card that draws the plan as soon as it is there; `progress` and `close` as the plot's. */
export function pathCard(live) {
  const view = h("div", { class: "path-view", role: "img", "aria-label": t("path.title") });
  const missing = h("div", { class: "path-view path-missing" }, t("path.waiting"));
  const tools = h("div", { class: "path-tools", hidden: true });
  const key = legend(live);
  const element = h("section", { class: `card path-card${live ? " is-live" : ""}` },
    key, missing, view, tools);
  mark(view, "hidden", "");
  let plan = null;
  let plot = null;
  let reached = null; // told before the picture is there, and of an ended job never again
  let closed = false;

  async function draw(next, machine) {
    plan = next;
    missing.hidden = true;
    view.hidden = false;
    if (plan.tracker_mm) key.append(entry("sight", t("curve.sight")));
    if (plan.keep_out?.length) key.append(entry("box", t("keepout.title")));
    const drawn = await drawPath(view, plan, machine);
    if (closed) drawn.close();
    else show(drawn);
  }

  function show(drawn) {
    plot = drawn;
    if (reached) plot.progress(...reached);
    view.dataset.drawn = "";
    tools.append(segments(t("path.view"), VIEWS.map((name) => [name, t(`path.${name}`)]), "iso",
      plot.view, true));
    tools.hidden = false;
  }

  return {
    element,
    update(next, machine) {
      if (next && !plan) draw(next, machine);
    },
    progress(done, position) {
      reached = [done, position];
      plot?.progress(done, position);
    },
    close() {
      closed = true;
      plot?.close();
    },
  };
}

const entry = (name, text) => h("li", { class: `is-${name}` }, h("i"), text);

function legend(live) {
  return h("ul", { class: "path-legend" }, entry("planned", t("path.planned")),
    live && [entry("done", t("path.done")), entry("now", t("path.now"))]);
}
