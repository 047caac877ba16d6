"""A page in a real browser over a service that a test steps through."""

from __future__ import annotations

import os
import shutil
import socket
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import uvicorn
from fastapi import FastAPI
from playwright.sync_api import (
    Browser,
    BrowserContext,
    Page,
    Playwright,
    expect,
    sync_playwright,
)

sys.path.append(str(Path(__file__).parent))
from scripted_app import scripted_app
from scripted_service import ScriptedService

LOOPBACK = "127.0.0.1"
PATIENCE_MS = 10_000.0
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
_NO_GRAPHICS = _GRAPHICS % "null"
_GRAPHICS_CARD = (
    _GRAPHICS % '{ getExtension: () => null, getParameter: () => "ANGLE (a card)" }'
)


@pytest.fixture
def service() -> ScriptedService:
    """The service's part of the play; nobody listens yet."""
    return ScriptedService()


class SharedServer:
    """An address at which one scripted service answers after the other.

    It stays the same so that browsers keep the hundred files of the page.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.app: FastAPI | None = None

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        assert self.app is not None, "no service is there"
        await self.app(scope, receive, send)


@pytest.fixture(scope="module")
def shared_server() -> Iterator[SharedServer]:
    """Where scripted services listen."""
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
    """Where the scripted service listens."""
    shared_server.app = scripted_app(service)
    yield shared_server.address
    service.closing.set()


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    # No longer than a module: its event loop runs in this thread.
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def browser(playwright: Playwright) -> Iterator[Browser]:
    """Debian's Chromium. A missing browser fails: the page is not proven without it."""
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if found is None:
        pytest.fail(
            "Chromium is missing, the page cannot be tested: "
            "apt-get install --no-install-recommends chromium, or set CHROMIUM"
        )
    running = playwright.chromium.launch(executable_path=found)
    yield running
    running.close()


@dataclass
class Contexts:
    """Browsers of operators, empty but for the files of the page."""

    browser: Browser
    address: str
    free: dict[str, list[BrowserContext]] = field(default_factory=dict)

    def take(self, **options: Any) -> tuple[str, BrowserContext]:
        """Return one that nobody uses, and its kind."""
        kind = repr(options)
        waiting = self.free.get(kind)
        context = waiting.pop() if waiting else self.browser.new_context(**options)
        return kind, context

    def give_back(self, kind: str, context: BrowserContext) -> None:
        """Forget what its pages have stored; one without page or kind is closed."""
        if not context.pages or not kind:
            context.close()
            return
        for page in context.pages:
            page.close()
        empty = context.new_page()
        kept = {"origin": self.address, "storageTypes": "local_storage,indexeddb"}
        session = context.new_cdp_session(empty)
        session.send("Storage.clearDataForOrigin", kept)
        context.clear_cookies()
        empty.close()
        self.free.setdefault(kind, []).append(context)


@pytest.fixture(scope="module")
def contexts(browser: Browser, shared_server: SharedServer) -> Contexts:
    return Contexts(browser, shared_server.address)


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
        page.on("console", lambda m: m.type == "error" and self._note(m.text))
        page.on("pageerror", lambda error: self._note(str(error)))
        page.on("request", lambda request: self._meet(request.url))

    def judge(self) -> None:
        assert self.errors == []
        assert self.strangers == []

    def _note(self, text: str) -> None:
        if not any(fragment in text for fragment in self.expected):
            self.errors.append(text)

    def _meet(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("data", "blob") and parts.hostname != LOOPBACK:
            self.strangers.append(url)


@pytest.fixture
def witness() -> Witness:
    return Witness()


@dataclass
class Panel:
    """Opens pages as an operator's panel would: size, language, light or dark."""

    contexts: Contexts
    address: str
    service: ScriptedService
    witness: Witness
    taken: list[tuple[str, BrowserContext]] = field(default_factory=list)

    def open(
        self,
        where: str = "",
        *,
        size: tuple[int, int] = (1280, 800),
        language: str = "en",
        dark: bool = False,
        touch: bool = False,
        before: str = "",
        hears: bool = True,
        card: bool = False,
        own: bool = False,
    ) -> Page:
        """Open the page; `before` is a script that runs before those of the page.

        A page of its own has a browser that no other test gets: its clock is changed.
        A page that hears has its stream of events when this returns. With a graphics
        card pictures in space are drawn by plotly.js, which takes ten times as long.
        """
        self.service.is_heard.clear()
        kind, context = self.contexts.take(
            locale=language,
            color_scheme="dark" if dark else "light",
            has_touch=touch,
        )
        self.taken.append(("" if own else kind, context))
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.add_init_script((_GRAPHICS_CARD if card else _NO_GRAPHICS) + before)
        self.witness.watch(page)
        page.goto(f"{self.address}/{where}", wait_until="domcontentloaded")
        if hears:
            assert self.service.is_heard.wait(PATIENCE_MS / 1000), "no stream of events"
        return page


@pytest.fixture
def panel(
    contexts: Contexts, address: str, service: ScriptedService, witness: Witness
) -> Iterator[Panel]:
    """Opens pages; afterwards no console error and no request to elsewhere."""
    panel = Panel(contexts, address, service, witness)
    yield panel
    try:
        for kind, context in panel.taken:
            contexts.give_back(kind, context)
    finally:
        witness.judge()
