"""What is known while the machine moves: tables, a target, an early end."""

import io
import re
from typing import Any

import pytest
from PIL import Image, ImageStat
from playwright.sync_api import Page, expect

from page_steps import STREAM, assert_fits, choose, go, overlapping
from scripted_data import TURNTABLE, estimate, turntable_estimate
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

SIZES = [(390, 844), (800, 1280), (1024, 768), (1280, 800), (1920, 1080)]
STARTED = "2026-03-14T08:01:00.000Z"


def test_the_tables_tighten_with_each_line(panel, service):
    job = service.measuring()
    page = tables(panel)
    expect(page.locator(".estimate-card")).to_contain_text("after a few lines")
    service.estimate(job, 4)
    exx = page.locator("[data-symbol=EXX] header strong")
    expect(exx).to_have_text("± 6.5")
    expect(page.locator(".charts .chart canvas")).to_have_count(6)
    expect(page.locator(".estimate-age")).to_have_text("From 4 of 22 lines, 0 s old")
    before = drawn(page, "EXX")
    service.estimate(job, 12)
    expect(exx).to_have_text("± 1.3")
    assert drawn(page, "EXX") != before
    expect(page.locator(".estimate-singles tbody tr").first).to_contain_text(
        "23.4 ± 1.7 µrad"
    )
    page.get_by_role("button", name="Axis Z").click()
    expect(page.get_by_role("group", name="Axis Z")).to_be_visible()
    expect(page.locator(".charts .chart canvas")).to_have_count(5)
    expect(page.locator("[data-symbol=ECZ]")).to_contain_text("Not determined")
    for chart in page.locator(".charts .chart-plot").all():
        name = re.compile(r"^E[A-Z]Z, .+ ± ?|U \(k = 2\)")
        expect(chart).to_have_accessible_name(name)
    page.emulate_media(color_scheme="dark")
    expect(page.locator(".charts .chart canvas")).not_to_have_count(0)
    # Of the page: the card is drawn anew in the new colours.
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))
    assert ImageStat.Stat(picture.convert("L")).mean[0] < 70


def test_numbers_that_do_not_count_or_are_left_out_say_so(panel, service):
    job = service.measuring()
    page = tables(panel)

    def tell(kind: str, state: str, **values) -> None:
        verdict = verdict_json(Verdict((Reason(kind, state, values),)))
        service.estimate(job, {**estimate(8), "verdict": verdict})

    tell("spikes-left-out", "usable", samples=3, distance_um=48.0)
    expect(page.get_by_role("status").filter(has_text="left out")).to_have_text(
        "3 lone samples are left out: they lie up to 48.0 µm aside."
    )
    tell("lines-off", "not-usable", lines="9, 10", distance_um=48.0)
    notice = page.locator(".notice.is-fault")
    expect(notice).to_contain_text("These numbers do not count")
    expect(notice).to_contain_text("do not fit what came before")
    expect(page.locator(".estimate-content")).to_have_class(re.compile("stale"))
    service.estimate(job, 11)
    expect(notice).to_have_count(0)


APART = (  # of the card, and what stands about it
    ".run-chooser, .estimate-tools .segments, .estimate-age, .course, "
    ".estimate-singles, .charts .chart, .chart h3, .chart header > strong, "
    "main .card > .big-progress, #pause, #resume, .readout"
)
OPENED = """window.openStream = () => new Real(url).addEventListener("open", () =>
  this.dispatchEvent(new Event("open")));"""


def test_what_was_told_before_the_stream_opens_is_shown(panel, service):
    job = service.measuring(started=STARTED)
    service.estimate(job, 12)
    page = panel.open(before=STREAM % OPENED, hears=False)
    page.get_by_role("button", name="Error tables").click()
    age = page.locator(".estimate-age")
    expect(age).to_contain_text("From 12 of 22 lines")
    service.estimate(job, 16)
    page.evaluate("openStream()")
    expect(age).to_contain_text("From 16 of 22 lines")


def test_a_rotary_axis_is_shown_over_degrees_and_fits_anywhere(panel, service):
    service.machine = TURNTABLE
    job = service.measuring(target_um=1.0)
    page = tables(panel, size=SIZES[0])
    service.estimate(job, turntable_estimate(8))
    drawn = page.locator(".charts .chart canvas")
    choose(page, "Deutsch")
    page.get_by_role("button", name="Tabellen").click()
    expect(drawn).to_have_count(6)
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        assert_fits(page)
        assert overlapping(page, APART) == []
    choose(page, "English")
    page.get_by_role("button", name="Error tables").click()
    page.get_by_role("button", name="Axis C").click()
    expect(drawn).to_have_count(6)
    chart = page.get_by_role("img", name="EXC, Error motion of C in X")
    expect(chart).to_have_accessible_name(re.compile("from −5.0 to 5.0 µm"))
    singles = page.locator(".estimate-singles")
    expect(singles.locator("tr", has_text="XOC")).to_contain_text("12.5 ± 0.8 µm")
    expect(singles.locator("tr", has_text="AOC")).to_contain_text("−8.0 ± 2.0 µrad")


def test_the_uncertainty_over_time_comes_with_its_target(panel, service):
    job = service.measuring(target_um=1.0)
    page = tables(panel)
    service.estimate(job, 4)
    expect(page.locator(".course-target")).to_have_text("target 2.0 µm")
    expect(page.get_by_role("img", name="U = 5.0 µm, target 2.0 µm")).to_be_visible()
    expect(page.locator("#uncertainty")).to_have_text(
        "U = 5.0 µm, target 2.0 µm (k = 2)"
    )
    before = page.locator(".course-plot canvas").evaluate("c => c.toDataURL()")
    service.estimate(job, 9)
    expect(page.get_by_role("img", name="U = 1.5 µm, target 2.0 µm")).to_be_visible()
    assert page.locator(".course-plot canvas").evaluate("c => c.toDataURL()") != before
    end = {"reason": "target-reached", "reached_um": 0.95, "done": 12, "total": 22}
    service.change(job, early_end=end)
    notice = page.locator("main .notice")
    expect(notice).to_contain_text("Target uncertainty reached")
    expect(notice).to_contain_text(
        "After 12 of 22 lines the volumetric uncertainty was U = 1.9 µm (k = 2); "
        "the target was 2.0 µm."
    )
    expect(notice).to_contain_text("The rest of the path is left out")
    service.finish(job)
    page.wait_for_url(f"**/#/result/{job}")
    expect(notice).to_contain_text("The rest of the path was left out.")
    # A run that goes to its end gives no reason.
    go(page, f"#/result/{service.measured(target_um=1.0)}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(notice).to_have_count(0)


def test_who_comes_later_sees_how_the_uncertainty_came_down(panel, service):
    job = service.measuring(started=STARTED)
    for lines in (3, 6, 9):
        service.estimate(job, lines)
    page = tables(panel)
    expect(page.locator(".estimate-age")).to_contain_text("From 9 of 22 lines")
    expect(page.locator(".course-plot canvas")).to_be_visible()
    late = inked(page)
    page.reload()
    page.get_by_role("button", name="Error tables").click()
    expect(page.locator(".course-plot canvas")).to_be_visible()
    assert inked(page) == pytest.approx(late, rel=0.1)
    alone = service.estimates[job]
    service.estimates[job] = {
        **alone,
        "course": {name: values[-1:] for name, values in alone["course"].items()},
    }
    page.reload()
    page.get_by_role("button", name="Error tables").click()
    expect(page.locator(".course-plot canvas")).to_be_visible()
    assert inked(page) < 0.8 * late


def test_an_estimate_that_is_not_renewed_is_stamped_stale(panel, service):
    job = service.measuring()
    page = tables(panel)
    service.estimate(job, 4)
    expect(page.locator(".estimate-content")).to_be_visible()
    stamp = page.locator(".estimate-head .stamp")
    expect(stamp).to_have_text(re.compile(r"ESTIMATE STALE since \d"))
    expect(page.locator(".estimate-content.is-stale-data")).to_be_visible()
    expect(page.locator("#stamp")).to_have_text("Live data")
    service.estimate(job, 5)
    expect(stamp).to_be_hidden()
    expect(page.locator(".estimate-content.is-stale-data")).to_have_count(0)


def tables(panel, **more: Any) -> Page:
    page = panel.open(**more)
    page.get_by_role("button", name="Error tables").click()
    return page


def drawn(page: Page, symbol: str) -> str:
    return page.locator(f"[data-symbol={symbol}] canvas").evaluate("c => c.toDataURL()")


def inked(page: Page) -> int:
    """Pixels of the course that are not background."""
    return page.locator(".course-plot canvas").evaluate(
        """async (canvas) => {
          for (let i = 0; i < 3; i += 1) await new Promise(requestAnimationFrame);
          const { data } = canvas.getContext("2d")
            .getImageData(0, 0, canvas.width, canvas.height);
          return data.filter((v, i) => i % 4 === 3 && v > 0).length;
        }"""
    )
