"""What is said of a machine over its calibrations, and of what is recorded of it."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect
from scripted_data import machine_entry, machine_history

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

STANDING = {
    "machine": "default",
    "calibration": "job-2",
    "is_alarm": False,
    "tolerance": None,
    "has_changed": None,
    "reference_job": None,
}
SLOW_MS = 60_000.0  # without a graphics card
DATES = ("2026-03-01T08:00:00.000Z", "2026-04-02T08:00:00.000Z")


def measured(service) -> str:
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")
    service.finish(job["id"])
    return job["id"]


@pytest.mark.parametrize(
    ("known", "mark"),
    [
        ({}, "unknown"),
        ({"tolerance": "within"}, "calm"),
        ({"has_changed": False}, "calm"),
        ({"tolerance": "not-sure", "has_changed": False}, "unknown"),
    ],
)
def test_a_machine_is_marked_well_only_where_something_judges_it(
    panel, service, known, mark
):
    service.histories["default"] = machine_history("default", *DATES)
    service.standings["default"] = STANDING | known
    page = panel.open("#/machine")
    expect(page.locator("[data-standing]")).to_have_attribute("data-standing", mark)


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


@pytest.mark.parametrize(
    ("language", "said"),
    [
        ("en", ["Change since Mar 1, 2026", "4.2 µm", "by chance up to 0.9 µm"]),
        ("de", ["Änderung seit 01.03.2026", "4,2 µm", "durch Zufall bis 0,9 µm"]),
    ],
)
def test_a_machine_says_how_far_it_has_drifted(panel, service, language, said):
    service.histories["default"] = machine_history("default", *DATES)
    service.standings["default"] = STANDING | {"reference_job": "job-1"}
    service.changes = {
        "since": {"measured": DATES[0]},
        "volumetric": {"difference_um": 4.2, "by_chance_um": 0.9},
    }
    page = panel.open("#/machine", language=language)
    entry = page.locator("[data-machine=default]")
    for text in said:
        expect(entry).to_contain_text(text)
    assert ("changes", "default job-1 job-2") in service.looks


def test_a_result_stands_among_the_calibrations_of_its_machine(panel, service):
    job = measured(service)
    history = machine_history("default", *DATES)
    for calibration, name in zip(history["calibrations"], ("other", job), strict=True):
        calibration["job_id"] = name
    service.histories["default"] = history
    page = panel.open(f"#/result/{job}")
    rows = page.locator("[data-card=history] tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("this result")
    expect(rows.first).to_have_attribute("aria-current", "true")
    expect(rows.last).to_contain_text("15.3 ± 0.2 µm")
    link = rows.last.get_by_role("link")
    expect(link).to_have_attribute("href", "#/result/other")


def test_a_first_result_has_no_history(panel, service):
    job = measured(service)
    history = machine_history("default", DATES[0])
    history["calibrations"][0]["job_id"] = job
    service.histories["default"] = history
    page = panel.open(f"#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator("[data-card=history]")).to_be_hidden()


@pytest.mark.parametrize(
    ("after", "words"), [(0.7, r"15\.3 → 0\.7 µm"), (None, r"15\.3 ± 0\.2 µm")]
)
def test_what_nobody_has_named_is_called_by_machine_day_and_error(
    panel, service, after, words
):
    job = measured(service)
    service.jobs[job]["machine"] = "default"
    history = machine_history("default", DATES[0])
    history["calibrations"][0]["job_id"] = job
    history["calibrations"][0]["expected_after"][0] = after
    service.histories["default"] = history
    page = panel.open("#/records")
    name = page.get_by_label("Name of On the fly")
    machine = re.escape(service.machines[0]["name"])
    suggested = re.compile(rf"^{machine}, Mar 14, {words}$")
    expect(name).to_have_attribute("placeholder", suggested)
    expect(name).to_have_value("")
    row = page.locator("tr", has=name)
    expect(row.locator("td").nth(4)).to_have_text("15.3 ± 0.2 µm")


def test_why_an_error_motion_is_not_determined_is_said_once(panel, service):
    said = "ECZ (roll of Z) cannot be told from EXZ and EYZ with one tool length"
    service.result["observability"]["unobservable"] = [said]
    page = panel.open(f"#/result/{measured(service)}")
    chart = page.locator("[data-symbol=ECZ]")
    expect(chart).to_have_class(re.compile("is-missing"))
    expect(chart).to_contain_text("Not determined by these data")
    expect(page.get_by_text(said)).to_have_count(1)


def test_the_path_of_an_ended_measurement_is_drawn_as_driven(panel, service):
    # By plotly.js, whose picture comes after the last that is told of the job.
    page = panel.open(f"#/run/{measured(service)}", card=True)
    page.locator(".path-view[data-drawn]").wait_for(timeout=SLOW_MS)
    rows = len(service.plan["position"])
    driven = "document.querySelector('[data-drawn]').data[2].x.length"
    page.wait_for_function(f"{driven} === {rows}")


def test_a_number_is_stepped_in_one_row_on_a_telephone(panel, service):
    service.connected = True
    page = panel.open("#/plan", size=(390, 844), language="de")
    for stepper in page.locator(".stepper:visible").all():
        parts = stepper.locator("button, input").all()
        tops = {part.bounding_box()["y"] for part in parts}
        assert len(tops) == 1
