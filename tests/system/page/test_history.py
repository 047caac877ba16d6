"""What is said of a machine over its calibrations and Runs; when the next is due."""

import copy
import re
from typing import Any

import pytest
from playwright.sync_api import expect

from page_steps import NEXT, SLOW_MS, choose, expect_texts, go, job_of
from scripted_data import (
    EXAMPLES,
    machine_entry,
    machine_history,
    temperature_dependence,
)
from truepath.service.api.models.results.discovery import TrendOut

UNJUDGED = dict.fromkeys(("tolerance", "has_changed", "reference_job"))
STANDING = EXAMPLES["get_machine_standing"] | UNJUDGED | {"calibration": "job-2"}
DATES = ("2026-03-01T08:00:00.000Z", "2026-04-02T08:00:00.000Z")


def test_a_machine_is_marked_well_only_where_something_judges_it(panel, service):
    service.histories["default"] = machine_history("default", *DATES)
    page = panel.open("#/records")
    for known, mark in (
        ({}, "unknown"),
        ({"tolerance": "within"}, "calm"),
        ({"tolerance": "not-sure", "has_changed": False}, "unknown"),
        ({"has_changed": False}, "calm"),
    ):
        service.standings["default"] = STANDING | known
        go(page, "#/machine")
        standing = page.locator("[data-standing]")
        expect(standing).to_have_attribute("data-standing", mark)
        go(page, "#/records")
        expect(standing).to_have_count(0)


def test_each_machine_says_what_it_does_as_it_changes_and_its_drift(panel, service):
    service.histories["default"] = machine_history("default", *DATES)
    service.standings["default"] = STANDING | {"reference_job": "job-1"}
    service.changes = {
        "since": {"measured": DATES[0]},
        "volumetric": {"difference_um": 4.2, "by_chance_um": 0.9},
    }
    idle = machine_entry("idle", name="Idle", connected=False)
    bare = machine_entry("bare", name="Bare", cell="none", origin="catalogue")
    service.machines = [machine_entry(), idle, bare]
    page = panel.open("#/machine")
    state = page.locator("[data-machine=default] .machine-state")
    expect(page.locator("[data-machine=bare] .machine-state")).to_have_text(
        "No devices are set up"
    )
    expect(page.locator("[data-machine=idle] .machine-state")).to_have_text(
        "Not connected"
    )
    job = service.new_job("measure-otf", state="ready", machine="default")["id"]
    service.change(job, state="ready")
    expect(state).to_have_text("Ready to start")
    entry = page.locator("[data-machine=default]")
    choose(page, "Deutsch")
    expect_texts(entry, "Änderung seit 01.03.2026", "4,2 µm", "durch Zufall bis 0,9 µm")
    assert ("changes", "default job-1 job-2") in service.looks


def test_a_result_stands_among_the_calibrations_of_its_machine(panel, service):
    job = service.measured()
    card = "[data-card=history]"
    history = machine_history("default", *DATES)
    first, last = history["calibrations"]
    last["job_id"] = job
    service.histories["default"] = history | {"calibrations": [last]}
    page = panel.open(f"#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator(card)).to_be_hidden()  # a first result has no history
    first["job_id"] = "other"
    service.histories["default"] = history
    go(page, "#/records")
    go(page, f"#/result/{job}")
    rows = page.locator(f"{card} tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("this result")
    expect(rows.first).to_have_attribute("aria-current", "true")
    expect(rows.last).to_contain_text("15.3 ± 0.2 µm")
    link = rows.last.get_by_role("link")
    expect(link).to_have_attribute("href", "#/result/other")


def test_what_nobody_named_is_called_by_machine_day_and_error(panel, service, witness):
    witness.expect("status of 404")  # nothing stands of the machine
    history = machine_history("default", DATES[0])
    (calibration,) = history["calibrations"]
    calibration["job_id"] = service.measured()
    service.histories["default"] = history
    page = panel.open("#/machine")
    machine = re.escape(service.machines[0]["name"])
    for after, words in ((0.7, r"15\.3 → 0\.7 µm"), (None, r"15\.3 ± 0\.2 µm")):
        calibration["expected_after"][0] = after
        go(page, "#/records")
        name = page.get_by_label("Name of On the fly")
        suggested = re.compile(rf"^{machine}, Mar 14, {words}$")
        expect(name).to_have_attribute("placeholder", suggested)
        expect(name).to_have_value("")
        row = page.locator("tr", has=name)
        expect(row.locator("td").nth(4)).to_have_text("15.3 ± 0.2 µm")
        go(page, "#/machine")
        expect(page.locator("[data-machine]").first).to_be_visible()


@pytest.mark.long
def test_the_path_of_an_ended_measurement_is_drawn_as_driven(panel, service):
    # By plotly.js, whose picture comes after the last that is told of the job.
    page = panel.open(f"#/run/{service.done('measure-otf')}", card=True)
    page.locator(".path-view[data-drawn]").wait_for(timeout=SLOW_MS)
    rows = len(service.plan["position"])
    driven = "document.querySelector('[data-drawn]').data[2].x.length"
    page.wait_for_function(f"() => {driven} === {rows}")


def test_what_depends_on_temperature_is_said_with_its_uncertainty(panel, service):
    service.measured()
    page = panel.open("#/records")
    card = page.locator("[data-card=dependence]")
    assert service.looks == []
    ask = card.get_by_role("button", name="Work it out")
    for view in ("records", "trend"):
        service.temperature = temperature_dependence()
        go(page, f"#/{view}")
        ask.click()
        expect(card).to_contain_text("depend on temperature: EXX")
        expect(card.locator("[data-axis=X]")).to_contain_text("11.4 ± 0.6 µm/(m·K)")
        first, last = (card.locator("[data-symbol]").nth(i) for i in range(2))
        expect(first).to_contain_text("EXX")
        expect(last).to_contain_text("not detected")
        expect(card.locator(".notice")).to_have_count(0)
        service.temperature["verdict"] = "doubtful"
        ask.click()
        expect(card.locator(".notice.is-held")).to_be_visible()
    assert service.looks == [("temperature", "default")] * 4


def test_calibrations_that_do_not_tell_are_said_so(panel, service, witness):
    witness.expect("422")
    page = panel.open("#/records")
    card = page.locator("[data-card=dependence]")
    said = card.locator(".notice")
    card.get_by_role("button", name="Work it out").click()
    expect_texts(said, "Not determined by the calibrations", "2 of 3 temperatures")
    service.temperature_refusal = (
        "the results are at 2 different temperatures (20.1, 20.3, 24.0 °C; less than "
        "0.5 K apart counts as one): measure at three or more"
    )
    choose(page, "Deutsch")
    card.get_by_role("button", name="Berechnen").click()
    expect(said).to_contain_text("bei 2 verschiedenen Temperaturen")
    expect(said).to_contain_text("(20,1; 20,3; 24,0 °C; weniger als 0,5 K")
    expect(said).not_to_contain_text("measure")


def trend_of(state: str, **outlook: Any) -> dict[str, Any]:
    """Return a `trend.json` with an answer: that of the example, of seven errors."""
    content = copy.deepcopy(EXAMPLES["get_trend"])
    for one in (*content["runs"], *content["later"]):
        tables = one["error_tables"]
        tables |= dict.fromkeys(("EZX", "EXY", "EYY", "EZY", "EXZ"), tables["EXX"])
    content["outlook"] |= {
        "state": state,
        "grade": None,
        "limit_um": 5.0,
        "chance": 0.05,
        "exceeded": 0.3,
        "due_h": 4.5,
        "expected_h": None,
        "time_h": [2.0, 8.0, 26.0],
        "median_um": [0.4, 2.0, 3.0],
        "high_um": [0.9, 6.0, 9.0],
        **outlook,
    }
    TrendOut.model_validate(content, extra="forbid")
    return content


def test_runs_are_chosen_and_followed_over_time(panel, service):
    service.trend = trend_of("due", expected_h=8.25, exceeded=0.9, grade="likely")
    service.add_run("run-a")
    page = panel.open("#/records")
    expect(page.get_by_role("button", name="Follow over time")).to_have_count(0)
    service.add_run("run-b")
    page.reload()
    page.get_by_role("button", name="Follow over time").click()
    ask = page.locator(NEXT)
    expect(page.locator("#reason")).to_have_text("Choose two Runs or more.")
    expect(ask).to_be_disabled()
    for run, hours in (("run-a", "9.5"), ("run-b", "8")):
        row = page.locator(f"[data-run={run}]")
        row.get_by_role("checkbox").check()
        row.get_by_role("textbox").fill(hours)
    ask.click()
    page.wait_for_url("**/#/run/*")
    (order,) = service.orders()
    assert order["kind"] == "trend"
    assert (order["run_ids"], order["at_h"]) == (["run-b", "run-a"], [8, 9.5])
    assert order["limit_um"] == 5
    expect(page.locator(".stages [aria-current]")).to_have_text("Following")
    job = job_of(page)
    service.finish(job)
    page.wait_for_url(f"**/#/trend/{job}")
    said = page.locator("[data-state=due]")
    expect(said).to_contain_text("Calibrate again at 4.5 h")
    expect(said).to_contain_text("an even chance by 8.3 h")
    expect(said).to_contain_text("Grade: likely")


def test_each_answer_is_said_in_the_language_of_the_page(panel, service):
    page = panel.open("#/records")
    for state, language, said in (
        ("cannot-be-said", "English", "Later cannot be said: the chance"),
        ("cannot-be-said", "Deutsch", "bleibt bis 4,5 h unter 5,0 µm"),
        ("not-known", "Deutsch", "drei oder mehr"),
        ("not-within-horizon", "Deutsch", "bleibt bis 26 h unter 5,0 µm"),
        ("not-within-horizon", "English", "stays below 5.0 µm up to 26 h"),
    ):
        service.trend = trend_of(state)
        choose(page, language)
        go(page, f"#/trend/{service.done('trend')}")
        expect(page.locator(f"[data-state={state}]")).to_contain_text(said)
    # What changes most is drawn first with its uncertainty.
    expect(page.locator(".trend .chart-plot.is-high canvas")).to_have_count(1)
    entries = page.locator(".charts .chart")
    expect(entries).to_have_count(6)
    expect(entries.first.locator("h3")).to_contain_text("EYX")
    expect(entries.first.locator(".chart-read")).to_contain_text("(k = 2)")
    page.get_by_role("button", name="All", exact=True).click()
    last = service.trend["runs"][-1]
    every = len(last["error_tables"]) + len(last["squareness_urad"])
    expect(entries).to_have_count(every)
    expect(page.locator("tbody tr")).to_have_count(3)
    report = page.get_by_role("link", name="Report")
    address = re.compile(f"/api/v1/jobs/{job_of(page)}/trend/report.html$")
    expect(report).to_have_attribute("href", address)
