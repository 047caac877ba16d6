"""A machine over time: which Runs, how far it is off, when to calibrate again."""

import copy
import re
from typing import Any

from playwright.sync_api import expect

from page_steps import NEXT, choose, go, job_of
from scripted_data import EXAMPLES
from truepath.service.api.models.results.trend import TrendOut


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
