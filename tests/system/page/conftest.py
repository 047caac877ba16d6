"""A page in a real browser over a service that a test steps through."""

import json
import os
import shutil
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
import uvicorn
from fastapi import Response
from playwright.sync_api import (
    Browser,
    ConsoleMessage,
    Page,
    Playwright,
    ViewportSize,
    expect,
    sync_playwright,
)

from page_steps import DESK
from scripted_app import scripted_app
from scripted_service import Played, ScriptedService

HERE = Path(__file__).parent
NOTHING = "/nothing"  # where a page waits for its next test
FORGET = (
    '<link rel="icon" href="data:,">'  # else it asks for one, heard in the next test
    "<script>localStorage.clear(), sessionStorage.clear()</script>"
)
LOOPBACK = "127.0.0.1"
PATIENCE_MS = 10_000.0
NAME = "shop-floor.test"
"""Of this computer, for the browser alone; nothing that a service knows."""
expect.set_options(timeout=PATIENCE_MS)

# What a page hears that asks for a graphics processor; a picture asks for any WebGL.
_GRAPHICS = """
{
  const own = HTMLCanvasElement.prototype.getContext;
  const found = %s;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    const isAsked = kind === "webgl" && more[0]?.failIfMajorPerformanceCaveat;
    return isAsked ? found : own.call(this, kind, ...more);
  };
}
"""
# Whatever the page has asked elsewhere for; the browser keeps 250 of all if not told.
_ALL_FILES = "performance.setResourceTimingBufferSize(100000);"
_STRANGERS = """(own) => performance.getEntriesByType("resource")
    .map((one) => new URL(one.name))
    .filter((url) => !["data:", "blob:"].includes(url.protocol) && url.hostname !== own)
    .map((url) => url.href)"""
# What a tap opens is open: most tests look inside.
_FOLDS = ("method", "place", "details", "blind", "run", "grade", "program")
_ALL_OPEN = json.dumps(dict.fromkeys(_FOLDS, True))
_UNFOLDED = (
    f"try {{ sessionStorage.setItem('truepath.folds', '{_ALL_OPEN}') }} catch {{}};"
)
_GRAPHICS_CARD = (
    _GRAPHICS % '{ getExtension: () => null, getParameter: () => "ANGLE (a card)" }'
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.parent == HERE and "playwright" in item.fixturenames:  # type: ignore[attr-defined]
            item.add_marker(pytest.mark.ui)


@pytest.fixture
def service() -> ScriptedService:
    return ScriptedService()


class SharedServer:
    """An address at which one scripted service answers after the other.

    It stays the same so that browsers keep the hundred files of the page, and the
    routes are made once: that takes longer than what most tests ask of them.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.played = Played()
        self._app = scripted_app(cast("ScriptedService", self.played))

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["path"] == NOTHING:
            await Response(FORGET, media_type="text/html")(scope, receive, send)
            return
        await self._app(scope, receive, send)


@pytest.fixture(scope="package")
def shared_server() -> Iterator[SharedServer]:
    listening = socket.create_server((LOOPBACK, 0))
    shared = SharedServer(f"http://{LOOPBACK}:{listening.getsockname()[1]}")
    config = uvicorn.Config(
        shared, log_level="warning", lifespan="off", timeout_graceful_shutdown=1
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    yield shared
    server.should_exit = True
    thread.join(timeout=10)
    listening.close()
    assert not thread.is_alive(), "the scripted services did not end"


@pytest.fixture
def address(service: ScriptedService, shared_server: SharedServer) -> Iterator[str]:
    shared_server.played.service = service
    yield shared_server.address
    service.closing.set()


@pytest.fixture(scope="package")
def playwright() -> Iterator[Playwright]:
    # No longer than this folder: its event loop runs in this thread.
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="package")
def browser(playwright: Playwright) -> Iterator[Browser]:
    """Debian's Chromium. A missing browser fails: the page is not proven without it."""
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if found is None:
        pytest.fail(
            "Chromium is missing, the page cannot be tested: "
            "apt-get install --no-install-recommends chromium, or set CHROMIUM"
        )
    rules = f"--host-resolver-rules=MAP {NAME} {LOOPBACK}"
    running = playwright.chromium.launch(executable_path=found, args=[rules])
    yield running
    running.close()


@dataclass
class Windows:
    """Browsers of operators, empty but for the files of the page.

    Each has one page, which stays for the next test: the process of a page that is
    closed ends with it, and with the process go the compiled scripts, which take longer
    than what most tests do.
    """

    browser: Browser
    address: str
    free: dict[str, list[Page]] = field(default_factory=dict)

    def take(self, clock: bool, **options: Any) -> tuple[str, Page]:
        kind = repr((clock, options))
        if waiting := self.free.get(kind):
            return kind, waiting.pop()
        viewport: ViewportSize = {"width": DESK[0], "height": DESK[1]}
        context = self.browser.new_context(viewport=viewport, **options)
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.goto(f"{self.address}{NOTHING}")
        return kind, page

    def give_back(self, kind: str, page: Page) -> None:
        for other in page.context.pages:
            if other is not page:
                other.close()
        page.unroute_all(behavior="ignoreErrors")
        page.mouse.move(-9, -9)  # it points at nothing
        page.goto(f"{self.address}{NOTHING}")
        page.context.clear_cookies()
        self.free.setdefault(kind, []).append(page)


@pytest.fixture(scope="package")
def windows(browser: Browser, shared_server: SharedServer) -> Windows:
    return Windows(browser, shared_server.address)


@dataclass
class Witness:
    """What went wrong in a page without being seen on it."""

    errors: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)
    expected: tuple[str, ...] = ()

    def expect(self, *fragments: str) -> None:
        """Accept console errors with these words: the test provokes them."""
        self.expected += fragments

    def watch(self, page: Page) -> None:
        page.on("console", self._hear)
        page.on("pageerror", self._note)

    def leave(self, page: Page) -> None:
        page.remove_listener("console", self._hear)
        page.remove_listener("pageerror", self._note)
        self.strangers += page.evaluate(_STRANGERS, LOOPBACK)

    def judge(self) -> None:
        assert self.errors == []
        assert self.strangers == []

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self._note(message.text)

    def _note(self, error: object) -> None:
        if not any(fragment in str(error) for fragment in self.expected):
            self.errors.append(str(error))


@pytest.fixture
def witness() -> Witness:
    return Witness()


@dataclass
class Panel:
    windows: Windows
    address: str
    service: ScriptedService
    witness: Witness
    taken: list[tuple[str, Page, Any]] = field(default_factory=list)

    def open(
        self,
        where: str = "",
        *,
        size: tuple[int, int] = DESK,
        language: str = "en",
        dark: bool = False,
        touch: bool = False,
        before: str = "",
        hears: bool = True,
        card: bool = False,
        clock: bool = False,
        motion: bool = False,
        unfolded: bool = True,
    ) -> Page:
        """Open the page; `before` is a script that runs before those of the page.

        A page whose clock is changed has a window that only such tests get.
        A page that hears has its stream of events when this returns. With a graphics
        card pictures in space are drawn by plotly.js, which takes ten times as long.
        Nothing moves on its own but where motion is wanted: that is drawn by the CPU.
        """
        self.service.is_heard.clear()
        kind, page = self.windows.take(clock, locale=language, has_touch=touch)
        viewport: ViewportSize = {"width": size[0], "height": size[1]}
        if page.viewport_size != viewport:
            page.set_viewport_size(viewport)
        page.emulate_media(
            color_scheme="dark" if dark else "light",
            reduced_motion="no-preference" if motion else "reduce",
        )
        graphics = _GRAPHICS_CARD if card else (_GRAPHICS % "null")
        before = (_UNFOLDED if unfolded else "") + before
        script = page.add_init_script(_ALL_FILES + graphics + before)
        self.taken.append((kind, page, script))
        self.witness.watch(page)
        page.goto(f"{self.address}/{where}", wait_until="domcontentloaded")
        if hears:
            assert self.service.is_heard.wait(PATIENCE_MS / 1000), "no stream of events"
        return page

    def close(self) -> None:
        for kind, page, script in self.taken:
            self.witness.leave(page)
            script.close()
            self.windows.give_back(kind, page)


@pytest.fixture
def panel(
    windows: Windows, address: str, service: ScriptedService, witness: Witness
) -> Iterator[Panel]:
    """Opens pages; afterwards no console error and no request to elsewhere."""
    panel = Panel(windows, address, service, witness)
    yield panel
    try:
        panel.close()
    finally:
        witness.judge()
