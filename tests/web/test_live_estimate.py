"""What is known while the machine moves: tables, a target, an early end."""

from __future__ import annotations

import io
import re

import pytest
from PIL import Image, ImageStat
from playwright.sync_api import Page, expect
from scripted_data import TURNTABLE, estimate, turntable_estimate

from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.service.page.pages import catalogue

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

SIZES = [(1280, 800), (1920, 1080), (1024, 768), (800, 1280), (390, 844)]
NEXT = "#next button"
STARTED = "2026-03-14T08:01:00.000Z"


def test_the_tables_tighten_with_each_line(panel, service):
    job = measuring(service)
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


@pytest.mark.parametrize(
    ("language", "title", "said"),
    [
        ("en", "These numbers do not count", "do not fit what came before"),
        ("de", "Diese Zahlen gelten nicht", "passen nicht zu dem, was vorher war"),
    ],
)
def test_numbers_that_do_not_count_say_so(panel, service, language, title, said):
    job = measuring(service)
    page = tables(panel, language=language)
    values = {"lines": "9, 10", "distance_um": 48.0}
    verdict = Verdict((Reason("lines-off", "not-usable", values),))
    service.estimate(job, {**estimate(8), "verdict": verdict_json(verdict)})
    notice = page.locator(".notice.is-fault")
    expect(notice).to_contain_text(title)
    expect(notice).to_contain_text(said)
    expect(page.locator(".estimate-content")).to_have_class(re.compile("stale"))
    service.estimate(job, 11)
    expect(notice).to_have_count(0)


def test_what_is_left_out_on_the_way_is_said_quietly(panel, service):
    job = measuring(service)
    page = tables(panel)
    values = {"samples": 3, "distance_um": 48.0}
    verdict = Verdict((Reason("spikes-left-out", "usable", values),))
    service.estimate(job, {**estimate(8), "verdict": verdict_json(verdict)})
    expect(page.get_by_role("status").filter(has_text="left out")).to_have_text(
        "3 lone samples are left out: they lie up to 48.0 µm aside."
    )


LATE_STREAM = """
const Real = WebSocket;
window.WebSocket = class extends EventTarget {
  constructor(url) {
    super();
    if (!url.includes("/events")) return new Real(url);
    this.close = () => {};
    window.openStream = () => {
      const source = new Real(url);
      source.addEventListener("open", () => this.dispatchEvent(new Event("open")));
    };
  }
};
"""


def test_what_was_told_before_the_stream_opens_is_shown(panel, service):
    job = measuring(service, started=STARTED)
    service.estimate(job, 12)
    page = panel.open(before=LATE_STREAM, hears=False)
    page.get_by_role("button", name="Error tables").click()
    age = page.locator(".estimate-age")
    expect(age).to_contain_text("From 12 of 22 lines")
    service.estimate(job, 16)
    page.evaluate("openStream()")
    expect(age).to_contain_text("From 16 of 22 lines")


def test_each_axis_has_its_tables_and_what_is_unknown_says_so(panel, service):
    job = measuring(service)
    page = tables(panel)
    service.estimate(job, 4)
    page.get_by_role("button", name="Axis Z").click()
    expect(page.get_by_role("group", name="Axis Z")).to_be_visible()
    expect(page.locator(".charts .chart canvas")).to_have_count(5)
    expect(page.locator("[data-symbol=ECZ]")).to_contain_text("Not determined")


def test_a_rotary_axis_is_shown_over_degrees_with_its_location(panel, service):
    service.machine = TURNTABLE
    job = measuring(service)
    page = tables(panel)
    service.estimate(job, turntable_estimate(8))
    page.get_by_role("button", name="Axis C").click()
    expect(page.locator(".charts .chart canvas")).to_have_count(6)
    chart = page.get_by_role("img", name="EXC, Error motion of C in X")
    expect(chart).to_have_accessible_name(re.compile("from −5.0 to 5.0 µm"))
    singles = page.locator(".estimate-singles")
    expect(singles.locator("tr", has_text="XOC")).to_contain_text("12.5 ± 0.8 µm")
    expect(singles.locator("tr", has_text="AOC")).to_contain_text("−8.0 ± 2.0 µrad")


def test_the_uncertainty_over_time_comes_with_its_target(panel, service):
    job = measuring(service, target_um=1.0)
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


def test_who_comes_later_sees_how_the_uncertainty_came_down(panel, service):
    job = measuring(service, started=STARTED)
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
    job = measuring(service)
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


def test_an_early_end_says_why_on_the_run_and_on_its_result(panel, service):
    job = measuring(service, target_um=1.0)
    page = panel.open()
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


def test_a_run_that_goes_to_its_end_gives_no_reason(panel, service):
    job = measuring(service, target_um=1.0)
    service.finish(job)
    page = panel.open(f"#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator("main .notice")).to_have_count(0)


def test_a_target_is_asked_as_u_and_sent_as_a_standard_uncertainty(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.get_by_label("End early at uncertainty U (k = 2)").fill("3")
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    ((_, _, order),) = service.requests
    assert order["target_um"] == 1.5
    (job,) = service.jobs
    service.change(job, state="ready")
    # Not any list: the grade of the set-up comes as one beside it.
    this_run = page.locator(".card", has=page.get_by_role("heading", name="This run"))
    expect(this_run.locator(".pairs")).to_contain_text("at U = 3.0 µm (k = 2)")


def test_a_target_goes_finer_and_coarser_up_to_none(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    field = page.locator("#target")
    expect(field).to_have_value("")
    page.get_by_label("Finer target").click()
    expect(field).to_have_value("5")
    page.get_by_label("Finer target").click()
    expect(field).to_have_value("2")
    for expected in ("5", "10", "20", "50", "100", ""):
        page.get_by_label("Coarser target").click()
        expect(field).to_have_value(expected)
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    ((_, _, order),) = service.requests
    assert "target_um" not in order


@pytest.mark.parametrize("typed", ["0", "0.05", "2000", "much"])
def test_a_target_out_of_limits_cannot_be_planned(panel, service, typed):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("#target").fill(typed)
    expect(page.locator("#target-error")).to_have_text("From 0.1 to 1,000 µm.")
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_contain_text("target uncertainty")


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_german_tables_fit_and_nothing_lies_over_anything(panel, service, size):
    service.machine = TURNTABLE
    job = measuring(service, target_um=1.0)
    page = panel.open(size=size, language="de")
    page.get_by_role("button", name="Tabellen").click()
    service.estimate(job, turntable_estimate(8))
    expect(page.locator(".charts .chart canvas")).to_have_count(6)
    assert overlapping(page) == []
    assert page.evaluate("document.body.scrollWidth") <= size[0]


def test_the_tables_are_reached_and_turned_by_the_keyboard(panel, service):
    service.estimate(measuring(service, started=STARTED), 4)
    page = panel.open()
    expect(page.locator(".run-chooser")).to_be_visible()
    page.locator("#abort").focus()
    for name in ("Error tables", "Axis Y"):
        press_until(page, name)
        page.keyboard.press("Enter")
        button = page.get_by_role("button", name=name)
        expect(button).to_have_attribute("aria-pressed", "true")
    expect(page.locator("[data-symbol=EYY] canvas")).to_be_visible()
    for chart in page.locator(".charts .chart-plot").all():
        expect(chart).to_have_accessible_name(
            re.compile(r"^E[A-Z]Y, .+ ± ?|U \(k = 2\)")
        )


def test_live_tables_are_dark_in_the_dark(panel, service):
    job = measuring(service)
    page = panel.open(dark=True)
    page.get_by_role("button", name="Error tables").click()
    service.estimate(job, 4)
    expect(page.locator(".charts .chart canvas")).to_have_count(6)
    picture = Image.open(io.BytesIO(page.locator(".estimate-card").screenshot()))
    assert ImageStat.Stat(picture.convert("L")).mean[0] < 70


def measuring(service, **more) -> str:
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring", **more)
    service.advance(job["id"], 2.0)
    return job["id"]


def tables(panel, language="en") -> Page:
    """Open the page and turn to the tables."""
    page = panel.open(language=language)
    name = catalogue(language)["run.tables"]
    page.get_by_role("button", name=name).click()
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


def press_until(page: Page, name: str) -> None:
    """Press Tab until the button of that name has the focus."""
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == name:
            return
    pytest.fail(f"the keyboard does not reach {name}")


def overlapping(page: Page) -> list[str]:
    """Pairs of controls, charts and texts of the card that lie over each other."""
    return page.evaluate(
        """(selector) => {
          const found = [...document.querySelectorAll(selector)]
            .filter((e) => e.checkVisibility() && e.getBoundingClientRect().width);
          const over = (a, b) => {
            const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
            return p.left < q.right - 1 && q.left < p.right - 1
              && p.top < q.bottom - 1 && q.top < p.bottom - 1;
          };
          return found.flatMap((a, i) => found.slice(i + 1)
            .filter((b) => !a.contains(b) && !b.contains(a) && over(a, b))
            .map((b) => `${a.className} ${a.textContent} / ${b.className}`));
        }""",
        ".run-chooser, .estimate-tools .segments, .estimate-age, .course, "
        ".estimate-singles, .charts .chart, .chart h3, .chart header > strong, "
        "main .card > .big-progress, #pause, #resume, .readout",
    )
