"""ABORT reaches the machine from any window, and from behind any proxy.

One browser opens six HTTP/1.1 connections to a host, for all its windows together. The
devices run beside the service: the test looks what the control truly does.
"""

import re
import shutil
import socket
import subprocess
import time
from contextlib import closing, contextmanager

import pytest
from playwright.sync_api import Error, expect

from service_process import create, wait_for
from service_with_devices import (
    LONG_PATH,
    connect,
    moves,
    running_devices,
    service_of,
    set_in_motion,
)
from truepath.users.tls import create_certificate

pytestmark = pytest.mark.timeout(120)

NAME = "shop-floor.test"  # as the browser of these tests finds this computer
WITHIN_S = 1.0


@pytest.fixture(scope="module")
def rig():
    with running_devices() as started:
        yield started


@pytest.fixture(scope="module")
def client(rig, tmp_path_factory):
    trusted = {"TRUEPATH_TRUSTED_HOSTS": f'["{NAME}"]'}
    with service_of(rig, tmp_path_factory.mktemp("service"), **trusted) as asking:
        connect(asking)
        yield asking


@pytest.fixture(scope="module")
def one_browser(browser):
    """One operator's browser, of which all windows share their connections."""
    context = browser.new_context(ignore_https_errors=True, locale="en")
    context.set_default_timeout(20_000)
    yield context
    context.close()


@pytest.fixture
def context(one_browser):
    yield one_browser
    for page in one_browser.pages:
        page.close()


@pytest.fixture
def page(client, context):
    return open_window(client, context)


def open_window(client, context):
    page = context.new_page()
    page.goto(str(client.base_url), wait_until="commit")
    expect(page.locator("#stamp")).to_have_text("Live data", timeout=20_000)
    return page


def abort(page, rig):
    """Touch ABORT; return how long the control then went on, in s."""
    page.bring_to_front()  # one that nobody sees is drawn, and clicked, once a second
    begun_s = time.monotonic()
    page.locator("#abort").click(no_wait_after=True)
    while rig.read_state()["cnc"]["state"] == "running":
        assert time.monotonic() - begun_s < 10, "the machine drives on"
        time.sleep(0.02)
    took_s = time.monotonic() - begun_s
    expect(page.locator("#abort-title")).to_have_text("Motion stopped", timeout=10_000)
    return took_s


@pytest.mark.fault_row(32)
@pytest.mark.fault_row(46)
@pytest.mark.parametrize(
    "windows", [1, *(pytest.param(n, marks=pytest.mark.long) for n in (6, 8, 12))]
)
def test_abort_holds_the_machine_with_many_windows(
    rig, client, context, windows, measured
):
    pages = [open_window(client, context) for _ in range(windows)]
    job = set_in_motion(client, rig)
    took_s = abort(pages[-1], rig)
    measured(f"{windows} windows: held {took_s:.2f} s after the click")
    assert took_s < WITHIN_S
    assert not moves(rig)
    assert client.get(f"/api/v1/jobs/{job}").json()["state"] == "aborted"


NOTE_STAGES = """
  const note = () => {
    const sheet = document.getElementById("abort-sheet");
    (window.stages ??= []).push(sheet.hidden ? "" : sheet.dataset.stage);
  };
  document.addEventListener("DOMContentLoaded", () =>
    new MutationObserver(note).observe(document.getElementById("abort-sheet"),
      { attributes: true }));
"""


@pytest.mark.long
@pytest.mark.fault_row(17)
@pytest.mark.fault_row(32)
def test_a_stop_that_the_controller_ignores_is_never_confirmed(context, tmp_path):
    page = context.new_page()
    page.add_init_script(NOTE_STAGES)
    with running_devices() as rig, service_of(rig, tmp_path) as client:
        connect(client)
        page.goto(str(client.base_url))
        set_in_motion(client, rig)
        rig.inject("cnc:ignore-commands@0s+600s")
        page.locator("#abort").click()
        sheet = page.locator("#abort-sheet")
        expect(sheet).to_have_attribute("data-stage", "unconfirmed", timeout=10_000)
        assert "emergency stop" in page.locator("#abort-text").inner_text().lower()
        wait_for(lambda: not moves(rig), "the machine's own watchdog", 9.0)
        assert client.get("/api/v1/system").json()["current_job"] is None
        for _ in range(3):
            with page.expect_response(lambda answer: "/api/v1/jobs" in answer.url):
                pass
    assert not {"confirmed", "idle"} & set(page.evaluate("window.stages"))


OCCUPY = {
    "eight streams": """() => { for (let n = 0; n < 8; n += 1)
        new EventSource("/api/v1/events?n=" + n); }""",
    "uploads": """() => {
        const large = new Blob([new Uint8Array(1e8)]);
        for (let n = 0; n < 8; n += 1) {
        const body = new FormData();
        body.append("bundle", large, "run.zip");
        fetch("/api/v1/runs", { method: "POST", body }).catch(() => {});
        } }""",
}


@pytest.mark.fault_row(46)
@pytest.mark.long
@pytest.mark.parametrize("occupied", OCCUPY)
def test_abort_waits_for_no_other_request_of_its_browser(
    rig, client, context, page, occupied, measured
):
    set_in_motion(client, rig)
    other = context.new_page()
    other.goto(f"{str(client.base_url).rstrip('/')}/healthz")
    other.evaluate(OCCUPY[occupied])
    other.wait_for_timeout(300)
    took_s = abort(page, rig)
    measured(f"{occupied}: held {took_s:.2f} s after the click")
    assert took_s < WITHIN_S


@pytest.mark.fault_row(46)
def test_abort_needs_neither_events_nor_its_channel(rig, client, context):
    page = context.new_page()
    page.route_web_socket("**/api/v1/**", lambda socket: socket.close())
    page.goto(str(client.base_url))
    expect(page.locator("#stamp")).to_contain_text("Asked each second")
    set_in_motion(client, rig)
    assert abort(page, rig) < WITHIN_S


@pytest.mark.fault_row(46)
def test_nothing_is_called_sent_that_the_service_has_not_taken(page):
    page.route("**/api/v1/stop*", lambda _: None)  # they wait for a connection
    page.route_web_socket("**/api/v1/stop", lambda _: None)
    page.reload()
    page.locator("#abort").click(no_wait_after=True)
    expect(page.locator("#abort-tries")).to_contain_text("2 times", timeout=10_000)
    assert "sent" not in page.locator("#abort-sheet").inner_text().lower()


def nginx() -> str:
    found = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
    if found is None:
        pytest.fail("nginx is missing: apt-get install --no-install-recommends nginx")
    return found


@contextmanager
def proxy(folder, locations, *, tls=False):
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    certificate = ""
    if tls:
        made = create_certificate([NAME], folder, 2)
        certificate = f"ssl_certificate {made.cert}; ssl_certificate_key {made.key};"
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    paths = " ".join(f"{kind}_temp_path {folder}/{kind};" for kind in kinds)
    settings = folder / "nginx.conf"
    settings.write_text(
        f"""daemon off; pid {folder}/pid; worker_processes 1; error_log stderr;
events {{ }}
http {{ access_log off; {paths}
  map $http_upgrade $connection_upgrade {{ default upgrade; '' close; }}
  types {{ text/html html; }}
  server {{ listen 127.0.0.1:{port}{" ssl" if tls else ""}; {certificate}
    location / {{ return 200 'another application'; }}
    {locations} }} }}
"""
    )
    running = subprocess.Popen([nginx(), "-e", "stderr", "-c", str(settings)])
    try:
        wait_for(lambda: is_answered(port), "nginx", 10.0)
        yield port
    finally:
        running.terminate()
        running.wait(10)


def is_answered(port):
    with closing(socket.socket()) as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


UPGRADE = """proxy_http_version 1.1; proxy_set_header Upgrade $http_upgrade;
  proxy_set_header Connection $connection_upgrade;"""
PASS = "proxy_pass http://127.0.0.1:{port}{path};"
HOST = "proxy_set_header Host $http_host;"
EITHER, PREFIX = "Live data|Asked", "/truepath/"
PROXIES = {
    "the default Host": (PASS, "", False, "/", EITHER),
    "the default Host and TLS": (PASS + UPGRADE, "", True, "/", EITHER),
    "a prefix cut off": (PASS + UPGRADE + HOST, "/", True, PREFIX, "Live data"),
    "a prefix and the default Host": (PASS, "/", False, PREFIX, EITHER),
}


@pytest.mark.fault_row(47)
@pytest.mark.parametrize("kind", PROXIES)
def test_abort_works_behind_nginx(rig, client, context, tmp_path, kind, measured):
    passing, path, tls, place, stamp = PROXIES[kind]
    passed = passing.format(port=client.base_url.port, path=path)
    where = f"location {place} {{ {passed} }}" if place != "/" else ""
    root = "" if where else f"location ~ .* {{ {passed} }}"
    with proxy(tmp_path, where + root, tls=tls) as port:
        page = context.new_page()
        missed = []
        page.on("response", lambda a: a.status == 404 and missed.append(a.url))
        page.goto(f"{'https' if tls else 'http'}://{NAME}:{port}{place}")
        expect(page.locator("#stamp")).to_contain_text(
            re.compile(stamp), timeout=20_000
        )
        expect(page.locator("#abort-alarm")).to_be_hidden()
        set_in_motion(client, rig)
        took_s = abort(page, rig)
        page.close()
    measured(f"behind nginx with {kind}: held {took_s:.2f} s after the click")
    assert took_s < WITHIN_S
    assert missed == []


@pytest.mark.fault_row(47)
def test_the_page_says_at_once_and_later_where_abort_does_not_arrive(
    client, context, tmp_path
):
    passed = PASS.format(port=client.base_url.port, path="")
    lost = "location ~ /stop { return 200 '{}'; }"
    with proxy(tmp_path, f"{lost} location ~ .* {{ {passed} }}") as port:
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{port}/")
        alarm = page.locator("#abort-alarm")
        expect(alarm).to_have_text(
            "ABORT DOES NOT REACH THIS MACHINE. Use its hardware emergency stop."
        )
        size = alarm.evaluate("e => parseFloat(getComputedStyle(e).fontSize)")
        assert size >= 26
    page.goto(str(client.base_url))
    expect(page.locator("#stamp")).to_have_text("Live data", timeout=20_000)
    expect(alarm).to_be_hidden()


def test_a_tab_that_nobody_sees_lets_go_of_its_stream(client, page):
    def turn(is_hidden):
        page.evaluate(
            """(hidden) => {
              Object.defineProperty(document, "hidden",
                { value: hidden, configurable: true });
              document.dispatchEvent(new Event("visibilitychange"));
            }""",
            is_hidden,
        )

    def streams():
        return "truepath_event_streams 1.0" in client.get("/metrics").text

    turn(True)
    wait_for(lambda: not streams(), "the end of the stream", 10.0)
    turn(False)
    wait_for(streams, "the stream", 10.0)
    expect(page.locator("#stamp")).to_have_text("Live data")


def test_nobody_sets_a_machine_in_motion_from_another_site(client, context, tmp_path):
    job = create(client, path=LONG_PATH)
    with proxy(tmp_path, "") as port:
        page = context.new_page()
        page.goto(f"http://{NAME}:{port}/")
        for verb in ("arming", "arm", "resume", "take-control"):
            where = f"{client.base_url}api/v1/jobs/{job['id']}/{verb}"
            told = page.evaluate(
                """async (where) => (await fetch(where, { method: "POST",
                  mode: "no-cors" }).catch((e) => ({type: "" + e}))).type""",
                where,
            )
            assert told
        with pytest.raises(Error):
            page.evaluate(
                f"""() => new Promise((done, fail) => {{
                  const socket = new WebSocket("ws://127.0.0.1:{client.base_url.port}"
                    + "/api/v1/events");
                  socket.onopen = done; socket.onerror = () => fail(new Error("no"));
                }})"""
            )
    assert client.get(f"/api/v1/jobs/{job['id']}").json()["state"] == "ready"
    client.post("/api/v1/stop")
