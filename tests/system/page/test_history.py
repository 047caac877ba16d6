"""What is said of a machine over its calibrations, and of what is recorded of it."""

import re

import pytest
from playwright.sync_api import expect

from page_steps import SLOW_MS, choose, go
from scripted_data import machine_entry, machine_history, temperature_dependence

STANDING = {
    "machine": "default",
    "calibration": "job-2",
    "is_alarm": False,
    "tolerance": None,
    "has_changed": None,
    "reference_job": None,
}
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


def test_each_machine_says_what_it_is_doing_as_it_changes(panel, service):
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


def test_a_machine_says_how_far_it_has_drifted(panel, service):
    service.histories["default"] = machine_history("default", *DATES)
    service.standings["default"] = STANDING | {"reference_job": "job-1"}
    service.changes = {
        "since": {"measured": DATES[0]},
        "volumetric": {"difference_um": 4.2, "by_chance_um": 0.9},
    }
    page = panel.open("#/machine")
    entry = page.locator("[data-machine=default]")
    choose(page, "Deutsch")
    for text in ("Änderung seit 01.03.2026", "4,2 µm", "durch Zufall bis 0,9 µm"):
        expect(entry).to_contain_text(text)
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


def test_what_nobody_has_named_is_called_by_machine_day_and_error(
    panel, service, witness
):
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
    expect(said).to_contain_text("Not determined by the calibrations")
    expect(said).to_contain_text("2 of 3 temperatures")
    service.temperature_refusal = (
        "the results are at 2 different temperatures (20.1, 20.3, 24.0 °C; less than "
        "0.5 K apart counts as one): measure at three or more"
    )
    choose(page, "Deutsch")
    card.get_by_role("button", name="Berechnen").click()
    expect(said).to_contain_text("bei 2 verschiedenen Temperaturen")
    expect(said).to_contain_text("(20,1; 20,3; 24,0 °C; weniger als 0,5 K")
    expect(said).not_to_contain_text("measure")
