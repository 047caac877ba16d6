"""A whole calibration on the page of the real service, by taps alone; and the next one.

One service has a machine that the model describes, simulated by itself; the devices of
the other, whose machine has backlash, run beside it and do what a test orders. A third
is added while its service runs; its truth is changed between two calibrations.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import Page, Response, expect
from tests.system.page.conftest import Panel

import service_with_devices
from page_steps import DESK, PHONE, Taps, assert_fits, held, job_of
from service_process import ROWS, arm, create, follow, process, wait_for
from truepath.client import Client
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.motion.configurations import select_rows
from truepath_drivers.cnc.modbus.map_records import path_crc, path_words
from truepath_drivers.transport.modbus_link import ModbusLink, TcpAddress
from truepath_simulators.bench.rig import Rig

pytestmark = [pytest.mark.long, pytest.mark.timeout(840)]

SPEED = 5.0
USUAL_SPEED = 3.0  # three windows are opened before the run ends
PATIENCE_MS = 120_000.0
TABLES_AT_MOST, CERTIFICATE_AT_MOST = 4, 9
BACKLASH = '{"name": "backlash", "axis": "X", "width_um": 8}'
STRAIGHT = "0 0 0\n500 500 500\n"
BUMP = "0 0 0\n250 250.06 250.06\n500 500 500\n"  # 60 µm too far in the middle of X


@pytest.fixture(scope="module")
def usual(tmp_path_factory) -> Iterator[httpx2.Client]:
    speed = {"TRUEPATH_SIMULATED_SPEED": str(USUAL_SPEED)}
    with process(tmp_path_factory.mktemp("usual"), **speed) as (_, client):
        yield client


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with service_with_devices.running_devices(speed=SPEED, hide=BACKLASH) as started:
        yield started


@pytest.fixture(scope="module")
def worn(rig, tmp_path_factory) -> Iterator[httpx2.Client]:
    # Nobody but the operator brings the beam back.
    patience = {"TRUEPATH_TRACKER_PATIENCE_S": '{"search": 0}'}
    with service_with_devices.service_of(
        rig, tmp_path_factory.mktemp("worn"), **patience
    ) as client:
        yield client


@pytest.fixture
def address(request: pytest.FixtureRequest) -> str:
    client = request.getfixturevalue(request.param)
    return str(client.base_url).rstrip("/")


def work_at(
    panel: Panel, where: str, *, language: str, size: tuple[int, int] = DESK
) -> Taps:
    """Open a page of the service for an operator who waits for devices."""
    options = {"language": language, "size": size, "touch": size == PHONE}
    page = panel.open(where, **options, hears=False)
    page.set_default_timeout(PATIENCE_MS)
    return Taps(page, PATIENCE_MS)


def state(page: Page, word: str) -> None:
    expect(page.locator("#state")).to_have_text(word, timeout=PATIENCE_MS)


@pytest.mark.parametrize("address", ["usual"], indirect=True)
def test_new_users_get_tables_in_4_taps_and_a_certificate_in_9(panel, usual, measured):
    operator = work_at(panel, "#/machine", language="en-GB")
    page = operator.page
    operator.press("To the devices")
    operator.press("Connect devices")
    operator.press("Prepare the run")
    operator.hold_until("Hold to start motion", "**/#/run/*")
    job = job_of(page)
    # A reload, a second tab and a phone follow the same run; each may act on it.
    state(page, "Running")
    page.reload()
    page.wait_for_url(f"**/#/run/{job}")
    state(page, "Running")
    tab = page.context.new_page()
    panel.witness.watch(tab)
    tab.goto(panel.address)
    phone = work_at(panel, "", language="de-DE", size=PHONE).page
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
    panel.witness.leave(tab)
    tab.close()
    page.wait_for_url(f"**/#/result/{job}", timeout=PATIENCE_MS)
    expect(page.locator("[data-symbol=EXX] canvas")).to_be_visible(timeout=PATIENCE_MS)
    assert operator.count <= TABLES_AT_MOST
    operator.press("Correct the machine")
    operator.press("Verify the machine")
    operator.press("Certificate without it", where="#aside button")
    operator.press("Issue the certificate")
    number = take_pdf(operator)
    assert operator.count <= CERTIFICATE_AT_MOST
    measured(f"{operator.count} taps to the PDF of certificate {number}")
    correct(operator, job)
    verify(operator, usual)
    operator.press("To the certificate")
    operator.press("Issue another", where="#aside button, #next button")
    expect(page.locator(".kept-list li")).to_have_count(2, timeout=PATIENCE_MS)
    (newest,) = usual.get(f"/api/v1/jobs/{job}/certificates").json()["items"][1:]
    assert "verification" in newest["sources_sha256"]


def read_share(page: Page) -> str:
    return page.locator(".big-progress strong").inner_text()


def take_pdf(operator: Taps) -> str:
    page = operator.page
    frame = page.frame_locator("iframe.preview")
    expect(frame.locator("h1")).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_download() as taken:
        page.locator(".preview-card a", has_text="PDF").click()
    operator.count += 1
    content = Path(taken.value.path()).read_bytes()
    assert content.startswith(b"%PDF")
    return taken.value.suggested_filename.removesuffix(".pdf")


def correct(operator: Taps, job: str) -> None:
    """Make the files of a control and load them into the simulated one."""
    page = operator.page
    page.locator(f".step a[href='#/export/{job}']").click()
    page.locator("[data-format=isg-csv]").click()
    with page.expect_download() as taken:
        page.locator("[data-card=export] .downloads a").click()
    assert Path(taken.value.path()).read_bytes().startswith(b"PK")
    page.locator("[data-load]").click()
    expect(page.locator("[data-unload]")).to_be_visible(timeout=PATIENCE_MS)


def verify(operator: Taps, client: httpx2.Client) -> None:
    """Drive points with the files in the control; they decide."""
    page = operator.page
    operator.press("Verify the machine")
    page.locator("[data-kind=diagonals]").click()
    page.locator("#verify-tolerance").fill("30")
    chosen = page.locator("#verify-files option:checked:not([value=''])")
    expect(chosen).to_be_attached(timeout=PATIENCE_MS)
    operator.press("Prepare the points")
    operator.hold_until("Hold to start motion", "**/#/run/*")
    proof = job_of(operator.page)
    page.wait_for_url(f"**/#/verify/{proof}", timeout=2 * PATIENCE_MS)
    expect(page.locator(".proof h2")).to_have_text("Pass", timeout=PATIENCE_MS)
    answer = client.get(f"/api/v1/jobs/{proof}/verification").json()
    assert answer["compensated"]


@pytest.mark.parametrize("address", ["worn"], indirect=True)
def test_a_german_phone_survives_faults_finds_and_uses_an_effect(panel, worn, rig):
    operator = work_at(panel, "#/connect", language="de-DE", size=PHONE)
    page = operator.page
    operator.press("Geräte verbinden")
    operator.press("Lauf vorbereiten")
    operator.hold_until("Zum Starten halten", "**/#/run/*")
    wait_for(lambda: service_with_devices.is_on_path(rig), "motion on the path")
    # Break the beam; the page says so, and goes on once the button is held.
    rig.inject(f"tracker:beam-break+{4 * SPEED}s")
    said = page.locator(".notice.is-held", has_text="Der Tracker hat den Reflektor")
    expect(said).to_be_visible(timeout=PATIENCE_MS)
    expect(said).to_contain_text("Der Vorschub ist angehalten.")
    state(page, "Angehalten")
    assert not service_with_devices.moves(rig)
    beam = page.locator(".stream .tile", has_text="Strahl")
    expect(beam).to_contain_text("erfasst", timeout=PATIENCE_MS)
    assert_fits(page)
    with held(page, page.locator("#resume")):
        state(page, "Läuft")
    expect(said).to_have_count(0)
    rig.inject(f"cnc:feed-hold+{4 * SPEED}s")
    said = page.locator(".notice.is-held", has_text="Vorschub an der Maschine")
    expect(said).to_be_visible(timeout=PATIENCE_MS)
    expect(said).to_contain_text("nichts ist verloren")
    state(page, "Angehalten")
    state(page, "Läuft")
    expect(said).to_have_count(0)
    page.wait_for_url("**/#/result/*", timeout=2 * PATIENCE_MS)
    assert_fits(page)
    found = discover(operator)
    operator.press("Neue Messung", where="#aside button")
    operator.press("Lauf planen")
    expect(page.locator(f"[data-model='{found}']")).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_response(is_order) as ordered:
        operator.press("Lauf vorbereiten")
    assert ordered.value.status == 202
    assert ordered.value.request.post_data_json["model_id"] == found
    assert worn.post("/api/v1/stop").status_code < 300


def is_order(answer: Response) -> bool:
    is_posted = answer.request.method == "POST"
    return is_posted and answer.url.endswith("/api/v1/jobs")


def discover(operator: Taps) -> str:
    """Ask what the model lacks and use what was found; return the job that found it."""
    page = operator.page
    operator.press("Entdecken", where=".step a")
    operator.press("Nach fehlenden Effekten suchen")
    page.wait_for_url("**/#/discover/*", timeout=2 * PATIENCE_MS)
    finding = page.locator("[data-effect=backlash]")
    expect(finding).to_contain_text("X", timeout=2 * PATIENCE_MS)
    expect(page.locator("[data-effect]")).to_have_count(1)
    assert_fits(page)
    page.get_by_role("button", name="Dieses Modell verwenden").click()
    return job_of(operator.page)


def read_path(rig: Rig) -> tuple[int, int]:
    options = rig.motion_options
    link = ModbusLink(TcpAddress(options["host"], options["port"]), options["unit"])
    link.open()
    (rows,), crc = link.read(104, 1), link.read(108, 2)
    link.close()
    return rows, crc[0] << 16 | crc[1]


@pytest.mark.parametrize("address", ["worn"], indirect=True)
def test_the_rows_in_the_controller_are_those_that_the_curve_shows(panel, worn, rig):
    def list_plans() -> list[dict]:
        return worn.get("/api/v1/jobs?kind=plan").json()["items"]

    service_with_devices.connect(worn)
    before = len(list_plans())
    operator = work_at(panel, "#/plan", language="en-GB")
    page = operator.page
    card = page.locator("[data-card=curve]")
    handle = card.locator(".handle")
    expect(handle).to_be_visible(timeout=PATIENCE_MS)
    plan = worn.get(f"/api/v1/plans/{list_plans()[0]['id']}").json()["commanded"]
    planned = decode_commanded_json(plan)
    for presses in (0, 4):  # untouched, then moved
        for _ in range(presses):
            handle.press("ArrowLeft")
        tile = card.locator(".tile", has_text="Lines or points").locator("dd")
        rows = int(tile.inner_text()) + 1
        operator.press("Prepare the run")
        operator.hold_until("Hold to start motion", "**/#/run/*")
        words = path_words(select_rows(planned, slice(rows)))
        shown = rows, path_crc(words)
        wait_for(lambda shown=shown: read_path(rig) == shown, "the path that is shown")
        assert worn.post("/api/v1/stop").status_code < 300
        follow(worn, job_of(page), "aborted")
        page.evaluate("location.hash = '#/plan'")
    assert len(list_plans()) == before + 1
    assert rows < len(planned)


@pytest.fixture
def changing(tmp_path) -> Iterator[tuple[httpx2.Client, Rig]]:
    """A service that gets a machine while it runs, and its devices."""
    with (
        service_with_devices.running_devices(speed=8.0) as rig,
        process(tmp_path, TRUEPATH_SIMULATED="0") as (_, asking),
    ):
        with Client(str(asking.base_url)) as service:
            machine = json.loads(
                service_with_devices.write_machine(tmp_path).read_text()
            )
            service.add_machine("mill", machine_file=machine)
            chosen = {
                "tracker_options": rig.tracker_options,
                "motion_options": rig.motion_options,
            }
            service.set_machine_devices("mill", **chosen)
            (one,) = service.list_machines()
            assert (one["id"], one["version"]) == ("mill", 2)
        yield asking, rig


def calibrate(client):
    place = "/api/v1/machines/mill:connect"
    wait_for(lambda: client.post(place).status_code == 200, "the devices")
    job = create(client, path=ROWS)
    arm(client, job)
    ended = follow(client, job["id"], "succeeded")
    assert ended["machine"] == "mill"
    return ended["id"]


def read_standing(client):
    return client.get("/api/v1/machines/mill/standing").json()


def test_a_changed_machine_raises_an_alarm_on_every_way(changing, browser, tmp_path):
    client, rig = changing
    table = tmp_path / "bump-X.tbl"  # it corrects from the start: that is no change
    table.write_text(STRAIGHT)
    rig.load_compensation([table])
    first = calibrate(client)
    wait_for(lambda: read_standing(client)["calibration"] == first, "the first")
    before = read_standing(client)
    assert (before["is_alarm"], before["has_changed"]) == (False, None)
    table.write_text(BUMP)
    rig.load_compensation([table])
    second = calibrate(client)
    wait_for(lambda: read_standing(client)["calibration"] == second, "the second")
    standing = read_standing(client)
    assert standing["is_alarm"], standing
    assert (standing["has_changed"], standing["reference_job"]) == (True, first)
    assert "EXX" in standing["change_text"]
    conditions = client.get("/api/v1/machines/mill/conditions").json()["items"]
    (unchanged,) = [one for one in conditions if one["type"] == "unchanged"]
    assert unchanged["level"] == "false"
    page = browser.new_context(locale="en").new_page()
    page.goto(f"{client.base_url}#/machine")
    card = page.locator("[data-machine=mill]")
    expect(card.locator("[data-standing=alarm]")).to_contain_text("changed")
    page.context.close()
