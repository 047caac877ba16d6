"""A whole calibration on the page of the real service, by taps alone.

One service has a machine that the model describes, simulated by itself; the devices of
the other, whose machine has backlash, run beside it and do what a test orders.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Response, expect

from page_steps import DESK, NEXT, PHONE, assert_fits, job_of
from service_process import arm, create, follow, process, wait_for
from service_with_devices import (
    connect,
    is_on_path,
    moves,
    running_devices,
    service_of,
)
from truepath_simulators.bench.rig import Rig

pytestmark = [pytest.mark.long, pytest.mark.timeout(840)]

SPEED = 5.0
USUAL_SPEED = 3.0  # three windows are opened before the run ends
PATIENCE_MS = 120_000.0
TABLES_AT_MOST, CERTIFICATE_AT_MOST = 4, 9
BACKLASH = '{"name": "backlash", "axis": "X", "width_um": 8}'
EVENTS = "**/api/v1/events*"
DROP = """([element, name, content]) => {
  const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([bytes], name, { type: "application/zip" }));
  for (const type of ["dragover", "drop"]) {
    element.dispatchEvent(
      new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
  }
}"""


class Operator:
    """Works at one page and counts the taps."""

    def __init__(self, page: Page) -> None:
        self.page, self.count = page, 0

    def tap(self, label: str, *, where: str = NEXT) -> None:
        button = self.page.locator(where, has_text=label)
        expect(button).to_be_enabled(timeout=PATIENCE_MS)
        button.click()
        self.count += 1

    def hold(self, label: str, address: str) -> None:
        """Hold the button that starts motion until the page has gone on."""
        button = self.page.locator(NEXT, has_text=label)
        with held(self.page, button):
            self.page.wait_for_url(address, timeout=PATIENCE_MS)
        self.count += 1

    @property
    def job(self) -> str:
        """The job that the address names."""
        return job_of(self.page)


@contextmanager
def held(page: Page, button: Locator) -> Iterator[None]:
    """Keep a button pressed."""
    expect(button).to_be_enabled(timeout=PATIENCE_MS)
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 40, box["y"] + box["height"] / 2)
    page.mouse.down()
    yield
    page.mouse.up()


class Panels:
    """Opens pages of a service; all of them are watched."""

    def __init__(self, browser: Browser, address: str, witness) -> None:
        self.browser, self.address, self.witness = browser, address, witness
        self.contexts: list[BrowserContext] = []

    def open(self, where: str, *, language: str, size: tuple[int, int]) -> Page:
        context = self.browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            locale=language,
            has_touch=size == PHONE,
        )
        self.contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        return self.open_tab(context.new_page(), where)

    def close(self) -> None:
        for context in self.contexts:
            for page in context.pages:
                self.witness.leave(page)
            context.close()
        self.witness.judge()

    def open_tab(self, page: Page, where: str) -> Page:
        self.witness.watch(page)
        page.goto(f"{self.address}/{where}")
        expect(page.locator("#main > *").first).to_be_visible(timeout=PATIENCE_MS)
        return page


@pytest.fixture(scope="module")
def usual(tmp_path_factory) -> Iterator[httpx2.Client]:
    """A client of the service with the usual simulated machine."""
    speed = {"TRUEPATH_SIMULATED_SPEED": str(USUAL_SPEED)}
    with process(tmp_path_factory.mktemp("usual"), **speed) as (_, client):
        yield client


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    """Devices of a machine with backlash, at a raised speed."""
    with running_devices(speed=SPEED, hide=BACKLASH) as started:
        yield started


@pytest.fixture(scope="module")
def worn(rig, tmp_path_factory) -> Iterator[httpx2.Client]:
    """A client of the service that has these devices."""
    # Nobody but the operator brings the beam back.
    patience = {"TRUEPATH_TRACKER_PATIENCE_S": '{"search": 0}'}
    with service_of(rig, tmp_path_factory.mktemp("worn"), **patience) as client:
        yield client


@pytest.fixture
def panels(browser, witness, request) -> Iterator[Panels]:
    """Opens pages; afterwards no console error and no request to elsewhere."""
    client = request.getfixturevalue(request.param)
    opened = Panels(browser, str(client.base_url).rstrip("/"), witness)
    yield opened
    opened.close()


def state(page: Page, word: str) -> None:
    expect(page.locator("#state")).to_have_text(word, timeout=PATIENCE_MS)


@pytest.mark.parametrize("panels", ["usual"], indirect=True)
def test_a_first_time_user_gets_tables_in_four_taps_and_a_certificate_in_nine(
    panels, usual, measured
):
    page = panels.open("#/machine", language="en-GB", size=DESK)
    operator = Operator(page)
    operator.tap("To the devices")
    operator.tap("Connect devices")
    operator.tap("Prepare the run")
    operator.hold("Hold to start motion", "**/#/run/*")
    job = operator.job
    look_on(panels, page, job)
    page.wait_for_url(f"**/#/result/{job}", timeout=PATIENCE_MS)
    expect(page.locator("[data-symbol=EXX] canvas")).to_be_visible(timeout=PATIENCE_MS)
    assert operator.count <= TABLES_AT_MOST
    operator.tap("Correct the machine")
    operator.tap("Verify the machine")
    operator.tap("Certificate without it", where="#aside button")
    operator.tap("Issue the certificate")
    number = take_pdf(operator)
    assert operator.count <= CERTIFICATE_AT_MOST
    measured(f"{operator.count} taps to the PDF of certificate {number}")
    correct(operator, job)
    verify(operator, usual)
    operator.tap("To the certificate")
    operator.tap("Issue another", where="#aside button, #next button")
    expect(page.locator(".kept-list li")).to_have_count(2, timeout=PATIENCE_MS)
    (newest,) = usual.get(f"/api/v1/jobs/{job}/certificates").json()["items"][1:]
    assert "verification" in newest["sources_sha256"]


def look_on(panels: Panels, page: Page, job: str) -> None:
    """A reload, a second tab and a phone follow the same run; each may act on it."""
    state(page, "Running")
    page.reload()
    page.wait_for_url(f"**/#/run/{job}")
    state(page, "Running")
    tab = panels.open_tab(page.context.new_page(), "")
    phone = panels.open("", language="de-DE", size=PHONE)
    for other in (tab, phone):
        other.wait_for_url(f"**/#/run/{job}")
    tab.locator("#pause").click()
    state(page, "Paused")
    state(tab, "Paused")
    state(phone, "Angehalten")
    shares = {read_share(one) for one in (page, tab, phone)}
    assert len(shares) == 1
    (share,) = shares
    assert_fits(phone)
    page.reload()
    state(page, "Paused")
    assert read_share(page) == share
    expect(page.locator(".path-view[data-drawn]")).to_be_visible(timeout=PATIENCE_MS)
    with held(phone, phone.locator("#resume", has_text="Zum Fortsetzen halten")):
        state(phone, "Läuft")
    state(page, "Running")
    for other in (phone, tab):
        panels.witness.leave(other)
        other.close()


def read_share(page: Page) -> str:
    """Return how much of the run is done, as the page says it."""
    return page.locator(".big-progress strong").inner_text()


def take_pdf(operator: Operator) -> str:
    """Take the certificate that was issued as PDF; return its number."""
    page = operator.page
    frame = page.frame_locator("iframe.preview")
    expect(frame.locator("h1")).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_download() as taken:
        page.locator(".preview-card a", has_text="PDF").click()
    operator.count += 1
    content = Path(taken.value.path()).read_bytes()
    assert content.startswith(b"%PDF")
    return taken.value.suggested_filename.removesuffix(".pdf")


def correct(operator: Operator, job: str) -> None:
    """Make the files of a control and load them into the simulated one."""
    page = operator.page
    page.locator(f".step a[href='#/export/{job}']").click()
    page.locator("[data-format=isg-csv]").click()
    with page.expect_download() as taken:
        page.locator("[data-card=export] .downloads a").click()
    assert Path(taken.value.path()).read_bytes().startswith(b"PK")
    page.locator("[data-load]").click()
    expect(page.locator("[data-unload]")).to_be_visible(timeout=PATIENCE_MS)


def verify(operator: Operator, client: httpx2.Client) -> None:
    """Drive points with the files in the control; they decide."""
    page = operator.page
    operator.tap("Verify the machine")
    page.locator("[data-kind=diagonals]").click()
    page.locator("#verify-tolerance").fill("15")
    chosen = page.locator("#verify-files option:checked:not([value=''])")
    expect(chosen).to_be_attached(timeout=PATIENCE_MS)
    operator.tap("Prepare the points")
    operator.hold("Hold to start motion", "**/#/run/*")
    proof = operator.job
    page.wait_for_url(f"**/#/verify/{proof}", timeout=2 * PATIENCE_MS)
    expect(page.locator(".proof h2")).to_have_text("Pass", timeout=PATIENCE_MS)
    answer = client.get(f"/api/v1/jobs/{proof}/verification").json()
    assert answer["compensated"]


@pytest.mark.parametrize("panels", ["usual"], indirect=True)
def test_a_bundle_dropped_on_the_page_is_analysed(panels, usual):
    bundle = usual.get(f"/api/v1/runs/{find_run(usual)}/bundle").content
    page = panels.open("#/records", language="de-DE", size=PHONE)
    zone = page.locator(".drop").element_handle()
    page.evaluate(DROP, [zone, "kept.zip", base64.b64encode(bundle).decode()])
    page.wait_for_url("**/#/run/*")
    page.wait_for_url("**/#/result/*", timeout=2 * PATIENCE_MS)
    expect(page.locator("[data-symbol=EXX] canvas")).to_be_visible(timeout=PATIENCE_MS)
    assert_fits(page)
    analysed = usual.get(f"/api/v1/jobs/{job_of(page)}").json()
    assert analysed["kind"] == "analyse"


def find_run(client: httpx2.Client) -> str:
    """Return a Run of the service, measured now where there is none."""
    runs = client.get("/api/v1/runs").json()["items"]
    if runs:
        return runs[-1]["id"]
    connect(client)
    job = create(client)
    arm(client, job)
    return follow(client, job["id"], "succeeded")["run_id"]


@pytest.mark.parametrize("panels", ["worn"], indirect=True)
def test_on_a_german_phone_faults_are_survived_and_a_hidden_effect_is_found_and_used(
    panels, worn, rig, witness
):
    page = panels.open("#/connect", language="de-DE", size=PHONE)
    operator = Operator(page)
    operator.tap("Geräte verbinden")
    operator.tap("Lauf vorbereiten")
    operator.hold("Zum Starten halten", "**/#/run/*")
    wait_for(lambda: is_on_path(rig), "motion on the path")
    lose_beam(page, rig)
    hold_feed(page, rig)
    page.wait_for_url("**/#/result/*", timeout=2 * PATIENCE_MS)
    assert_fits(page)
    found = discover(operator)
    operator.tap("Neue Messung", where="#aside button")
    operator.tap("Lauf planen")
    expect(page.locator(f"[data-model='{found}']")).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_response(is_order) as ordered:
        operator.tap("Lauf vorbereiten")
    assert ordered.value.status == 202
    assert ordered.value.request.post_data_json["model_id"] == found
    operator.hold("Zum Starten halten", "**/#/run/*")
    stop_without_stream(page, rig, witness)
    assert worn.get(f"/api/v1/jobs/{operator.job}").json()["state"] == "aborted"


def is_order(answer: Response) -> bool:
    """Whether the page has ordered a job."""
    is_posted = answer.request.method == "POST"
    return is_posted and answer.url.endswith("/api/v1/jobs")


def lose_beam(page: Page, rig: Rig) -> None:
    """Break the beam; the page says so, and goes on once the button is held."""
    rig.inject(f"tracker:beam-break+{4 * SPEED}s")
    said = page.locator(".notice.is-held", has_text="Der Tracker hat den Reflektor")
    expect(said).to_be_visible(timeout=PATIENCE_MS)
    expect(said).to_contain_text("Der Vorschub ist angehalten.")
    state(page, "Angehalten")
    assert not moves(rig)
    beam = page.locator(".stream .tile", has_text="Strahl")
    expect(beam).to_contain_text("auf dem Ziel", timeout=PATIENCE_MS)
    assert_fits(page)
    with held(page, page.locator("#resume")):
        state(page, "Läuft")
    expect(said).to_have_count(0)


def hold_feed(page: Page, rig: Rig) -> None:
    """Hold the feed at the machine; the run goes on when it is let go there."""
    rig.inject(f"cnc:feed-hold+{4 * SPEED}s")
    said = page.locator(".notice.is-held", has_text="Vorschub an der Maschine")
    expect(said).to_be_visible(timeout=PATIENCE_MS)
    expect(said).to_contain_text("nichts ist verloren")
    state(page, "Angehalten")
    state(page, "Läuft")
    expect(said).to_have_count(0)


def discover(operator: Operator) -> str:
    """Ask what the model lacks and use what was found; return the job that found it."""
    page = operator.page
    operator.tap("Entdecken", where=".step a")
    operator.tap("Nach fehlenden Effekten suchen")
    page.wait_for_url("**/#/discover/*", timeout=2 * PATIENCE_MS)
    finding = page.locator("[data-effect=backlash]")
    expect(finding).to_contain_text("X", timeout=2 * PATIENCE_MS)
    expect(page.locator("[data-effect]")).to_have_count(1)
    assert_fits(page)
    page.get_by_role("button", name="Dieses Modell verwenden").click()
    return operator.job


def stop_without_stream(page: Page, rig: Rig, witness) -> None:
    """ABORT with the stream of events blocked: the machine's own word counts."""
    witness.expect("net::ERR_FAILED", "Failed to load resource")
    page.route_web_socket(EVENTS, lambda socket: socket.close())
    page.reload()
    wait_for(lambda: is_on_path(rig), "motion on the path")
    expect(page.locator("#stamp")).to_contain_text("Sekunde", timeout=PATIENCE_MS)
    page.locator("#abort").click()
    title = page.locator("#abort-title")
    expect(title).to_have_text("Bewegung gestoppt", timeout=PATIENCE_MS)
    assert not moves(rig)
