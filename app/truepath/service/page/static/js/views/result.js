/* The step Result: error tables with their uncertainty, squareness, and what can be taken away. */
import { links } from "../api.js";
import { h, icon, write } from "../dom.js";
import { machineName } from "../flow.js";
import { term } from "../glossary.js";
import { card, earlyEndNotice, head, kindOf, linkButton, segments, tableFrame, tile } from "../parts.js";
import { COVERAGE, drawErrors, extentOf } from "../plots/error-chart.js";
import { prefer, preference } from "../preferences.js";
import { sayUnobservable } from "../statements.js";
import { singleErrors, tablesByAxis } from "../tables.js";
import { dateTime, known, number, t } from "../texts.js";
import { figure, quantity, unitOf } from "../units.js";
import { compareCard } from "./compare-card.js";
import { askCard } from "./discover.js";
import { gradeCard } from "./grade-card.js";
import { headline } from "./headline.js";
import { historyCard } from "./history-card.js";
import { mapCard } from "./map-card.js";
import { newMeasurement, onward } from "./onward.js";
import { findProof, isProof } from "./proof.js";
import { referenceCard } from "./reference-card.js";
import { residualCard } from "./residual-card.js";
import { showTable } from "./table-sheet.js";
import { overTimeCard } from "./trend-form.js";
import { usableMark, verdictBand } from "./verdict-band.js";

const BUDGET_COLUMNS = ["volume", "x", "y", "z"];

/** Button that leads on. */
export function lead(state, { go }) {
  return { next: onward("result", state, go), aside: newMeasurement(go),
    back: state.job ? { label: t("result.to_run"), run: () => go(`#/run/${state.job.id}`) } : null };
}

/** Show the result of the job. */
export function mount(root, { actions, go }) {
  let charts = [];
  let map = null;
  let residuals = null;
  let drawn = null;

  function close() {
    for (const chart of charts) chart.close();
    map?.close();
    residuals?.close();
    charts = [];
  }

  function draw({ job, result, runs, jobs, machines, machine_id }) {
    close();
    const body = h("div", { class: "stack" });
    const early = earlyEndNotice(job);
    const band = verdictBand(result.verdict);
    const top = h("div", { class: "result-top" });
    root.replaceChildren(heading(job, result, !band, machines), ...(band ? [band] : []), top,
      ...(early ? [h("div", { class: "below" }, early)] : []), body);
    const proof = jobs.some(isProof) ? findProof(job.id, jobs) : null;
    map = mapCard(job, result, proof, (step) => actions.did(step, job.id));
    const stream = runs.find((run) => run.id === job.run_id) ?? job.health;
    top.append(h("div", { class: "stack" }, headline(job, result, proof), summary(stream, result)), map.element);
    charts = drawTables(body, result);
    residuals = residualCard(result);
    body.append(...[budgetCard(result), residuals?.element, compareCard(job, result, jobs, map.addOther), historyCard(job, job.machine ?? machine_id), referenceCard(job), trialsCard(job, result, actions), askCard(job, actions), overTimeCard(runs, go)].filter(Boolean));
  }

  root.append(head(t("result.title")), h("p", { class: "empty" }, t("result.loading")));
  return {
    update(state) {
      const { job, result } = state;
      // Asked for twice it comes twice: what is being filled in stays.
      if (!result || job.id === drawn) return;
      drawn = job.id;
      draw(state);
    },
    close,
  };
}

/** Title and downloads; a result with nothing to say of itself has a mark. */
function heading(job, result, isUsable, machines) {
  const machine = machineName({ machines, machine_id: job.machine, machine: result.machine });
  const said = t("result.text", { machine, kind: kindOf(job.kind), when: dateTime(job.ended ?? job.created) });
  const row = head(t("result.title"), said);
  if (isUsable && result.verdict) row.querySelector("p").append(usableMark());
  row.append(downloads(job, result.verdict?.state));
  return row;
}

function downloads({ id, run_id }, state) {
  // What is taken away says in its name what its columns say: nobody reads it by mistake.
  const refused = state === "not-usable";
  const name = refused ? ["not-to-be-used", "not-to-be-used"] : ["error_tables", "result"];
  const csv = [refused ? links.acceptedCsv(id) : links.csv(id), `${name[0]}-${id}.csv`];
  return h("div", { class: "downloads", "aria-label": t("result.downloads"), role: "group" },
    linkButton(links.report(id), "report", t("result.report"), { target: "_blank", rel: "noopener" }),
    linkButton(csv[0], "download", "CSV", { download: csv[1] }),
    linkButton(links.json(id), "download", "JSON", { download: `${name[1]}-${id}.json` }),
    run_id && linkButton(links.bundle(run_id), "download", t("result.bundle"), { download: `${run_id}.zip` }));
}

/** The few numbers that matter; `stream` counts the samples. */
function summary(stream, result) {
  const all = tablesByAxis(result).flatMap((group) => group.tables);
  const tables = all.filter((table) => table.known);
  const worst = (kind) => tables.filter((table) => table.kind === kind)
    .map((table) => [Math.max(...table.values.map(Math.abs)), table.symbol])
    .sort((a, b) => b[0] - a[0])[0];
  const [error, angle] = [worst("error"), worst("angle")];
  const figures = [
    error && [t("result.worst", { symbol: error[1] }), error[0], "error"],
    angle && [t("result.worst", { symbol: angle[1] }), angle[0], "angle"],
    [t("result.residual"), result.residuals?.rms_um, "error"],
  ].filter(Boolean).map(([name, value, kind]) => {
    const shown = tile(name, figure(value, kind));
    shown.number.append(h("span", { class: "unit" }, unitOf(kind)));
    return shown.element;
  });
  const counts = [
    stream && [t("result.samples_lost"), `${number(stream.samples)} (${number(stream.lost_samples)})`],
    [t("result.determined"), `${number(tables.length)} / ${number(all.length)}`],
  ].filter(Boolean).map(([name, value]) => tile(name, value).element);
  return h("section", { class: "card verdict", "aria-label": t("result.summary") },
    h("dl", { class: "tiles" }, figures, counts));
}

function unseen(result) {
  const texts = result.observability?.unobservable ?? [];
  if (!texts.length) return null;
  return card(t("result.unobservable"), h("ul", { class: "lines" }, texts.map((text) => h("li", {}, sayUnobservable(text)))),
    h("p", { class: "quiet" }, t("result.unobservable_note")));
}

function drawTables(body, result) {
  const groups = tablesByAxis(result);
  const charts = [];
  const grid = h("div");
  const any = (has) => groups.some((group) => group.tables.some(has));
  const shows = { directed: any((table) => table.halves), continued: any((table) => table.extrapolated.some(Boolean)) };
  body.append(...[toolbar(() => fill(), shows), grid, squareness(result), gradeCard(result.grade),
    unseen(result)].filter(Boolean));
  fill();
  return charts;

  function fill() {
    for (const chart of charts.splice(0)) chart.close();
    grid.replaceChildren();
    const common = preference("scale") === "common" ? spans(groups) : null;
    for (const group of groups) {
      const plots = h("div", { class: "charts" });
      grid.append(h("div", { class: "axis-head" }, h("h3", {}, t("result.axis", { axis: group.axis }))), plots);
      for (const table of group.tables) {
        const [element, draw] = chartCard(table);
        plots.append(element);
        if (draw) charts.push(draw(common?.[table.kind] ?? null));
      }
    }
  }
}

/** The largest span of all tables of a kind: one scale makes them comparable. */
function spans(groups) {
  const all = groups.flatMap((group) => group.tables).filter((table) => table.known);
  const largest = (kind) => Math.max(0, ...all.filter((table) => table.kind === kind).map(extentOf).map(([low, high]) => high - low));
  return { error: largest("error"), angle: largest("angle") };
}

function toolbar(redraw, { directed, continued }) {
  const scale = segments(t("result.scale"),
    [["common", t("result.scale_common")], ["own", t("result.scale_own")]], preference("scale"),
    (value) => {
      prefer("scale", value);
      redraw();
    });
  const legend = h("ul", { class: "key" }, h("li", {}, h("i"), t("result.value")),
    h("li", { class: "is-band" }, h("i"), t("result.band", { k: COVERAGE })),
    directed && [h("li", { class: "is-up" }, h("i"), t("result.up")),
      h("li", { class: "is-down" }, h("i"), t("result.down"))],
    continued && h("li", { class: "is-hatched" }, h("i"), t("result.continued")));
  return h("div", { class: "result-bar" }, h("h2", {}, term("error_motion", t("result.tables"))), legend, scale);
}

function chartCard(table) {
  const unit = unitOf(table.kind);
  const read = h("p", { class: "chart-read" });
  const title = h("h3", {}, table.symbol, h("span", { class: "unit" }, unit), h("small", {}, table.name));
  const open = h("button", { class: "button is-plain",
    "aria-label": t("result.enlarge", { symbol: table.symbol }), onclick: () => showTable(table) }, icon("expand"));
  if (!table.known) {
    const missing = h("div", { class: "chart-missing" }, h("p", {}, t("result.unknown"))); // why is said below, once
    return [h("article", { class: "chart is-missing", "data-symbol": table.symbol },
      h("header", {}, title), missing), null];
  }
  const plot = h("div", { class: "chart-plot", role: "img", "aria-label": largest(table) });
  const element = h("article", { class: "chart", "data-symbol": table.symbol },
    h("header", {}, title, open), plot, read);
  return [element, (span) => {
    write(read, largest(table));
    return drawErrors(plot, table, { span, read: (text) => write(read, text || largest(table)) });
  }];
}

/** The largest value with its expanded uncertainty. */
function largest(table) {
  const at = table.values.reduce((best, v, i, all) => (Math.abs(v) > Math.abs(all[best]) ? i : best), 0);
  const expanded = COVERAGE * table.uncertainties[at];
  return t("result.largest", {
    value: figure(table.values[at], table.kind), u: quantity(expanded, table.kind) });
}

function squareness(result) {
  const rows = singleErrors(result).map(({ symbol, name, kind, value, uncertainty }) =>
    h("tr", {}, h("td", { class: "symbol" }, symbol), h("td", {}, name),
      h("td", { class: "right" }, quantity(value, kind)),
      h("td", { class: "right" }, `± ${uncertainty === null ? "–" : quantity(COVERAGE * uncertainty, kind)}`)));
  return card(term("squareness", t(result.axis_location ? "result.squareness_location" : "result.squareness")),
    tableFrame(t("result.squareness"), h("table", {},
      h("thead", {}, h("tr", {}, h("th", {}, t("result.symbol")), h("th", {}, t("result.between")),
        h("th", { class: "right" }, t("result.value")),
        h("th", { class: "right" }, term("k", t("result.u", { k: COVERAGE }))))),
      h("tbody", {}, rows))));
}

/** What the trials say, with the way to the report; or the button that asks for them. */
function trialsCard(job, result, actions) {
  const trials = result.monte_carlo;
  if (!trials) return job.run_id ? askingForTrials(job, actions) : null;
  const key = !trials.settled ? "trials.unsettled" : trials.agrees ? "trials.agrees" : "trials.differs";
  const counts = { trials: number(trials.trials), agreeing: number(trials.agreeing), numbers: number(trials.numbers) };
  return card(t("trials.title"), h("p", {}, t(key, counts)),
    h("div", {}, linkButton(links.report(job.id), "report", t("result.report"), { target: "_blank", rel: "noopener" })));
}

function askingForTrials(job, actions) {
  return card(t("trials.title"), h("p", { class: "quiet" }, t("trials.text")),
    h("div", {}, h("button", { class: "button", "data-needs": "operator", onclick: () => actions.validate(job.run_id) },
      icon("check"), h("span", {}, t("trials.ask")))));
}

/** The card; null where the result has no budget. */
function budgetCard({ uncertainty_budget: budget }) {
  if (!budget) return null;
  const { sources_um: sources, total_um: total } = budget;
  const share = ({ volume }) => (100 * volume ** 2) / (total.volume ** 2 || 1);
  const rows = Object.entries(sources).filter(([, parts]) => parts.volume > 0).sort((a, b) => b[1].volume - a[1].volume);
  const micro = unitOf("gap");
  const title = (text) => h("th", { class: "right", scope: "col" }, text);
  const cells = (parts) => BUDGET_COLUMNS.map((name) => h("td", { class: "right" }, figure(COVERAGE * parts[name], "gap")));
  const element = card(t("budget.title"),
    h("p", { class: "quiet" }, t("budget.text", { k: COVERAGE, unit: micro })),
    tableFrame(t("budget.title"), h("table", { class: "budget" },
      h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("budget.source")), h("th", { scope: "col" }, t("budget.share")),
        title(t("budget.volume")), ["X", "Y", "Z"].map(title))),
      h("tbody", {}, rows.map(([source, parts]) => h("tr", { "data-source": source }, h("td", {}, known(`budget.${source}`, source)),
        h("td", { class: "budget-share" }, h("i", { style: `width:${share(parts)}%` }), h("span", {}, `${number(share(parts), share(parts) < 10 ? 1 : 0)} %`)),
        cells(parts))), h("tr", { class: "budget-total" }, h("td", {}, t("budget.total")), h("td", {}, ""), cells(total))))));
  element.dataset.card = "budget";
  return element;
}
