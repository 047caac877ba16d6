"""What tests do on a page and look at, whatever its view."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Locator, Page, expect

NEXT = "#next button"
DESK, PHONE = (1280, 800), (390, 844)
SLOW_MS = 60_000.0  # a picture in space without a graphics card
STREAM = """
const Real = WebSocket;
window.WebSocket = class extends EventTarget {
  constructor(url) {
    super();
    if (!url.includes("/events")) return new Real(url);
    this.close = () => {};
    %s
  }
};
"""
"""A stream of events that does what it is told."""
# As behind a proxy that lets none through: each is closed at once.
NO_EVENTS = STREAM % 'setTimeout(() => this.dispatchEvent(new Event("close")));'


def follow(page: Page, label: str) -> None:
    page.locator(NEXT, has_text=label).click()


def prepare(page: Page) -> str:
    """Press the button that leads on to the check; return the job that is there."""
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    return job_of(page)


def job_of(page: Page) -> str:
    return page.url.rsplit("/", 1)[1]


def go(page: Page, where: str) -> None:
    page.goto(page.url.split("#")[0] + where)


def choose(page: Page, *names: str) -> None:
    page.locator("#open-settings").click()
    for name in names:
        page.locator("#settings").get_by_role("button", name=name).click()
        pressed = page.locator("#settings [aria-pressed=true]", has_text=name)
        expect(pressed).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#settings")).to_be_hidden()


def expect_texts(place: Locator, *texts: str) -> None:
    for text in texts:
        expect(place).to_contain_text(text)


@contextmanager
def held(page: Page, button: Locator) -> Iterator[None]:
    """Keep the button pressed meanwhile; it takes no effect before 1.5 s are over."""
    expect(button).to_be_enabled()
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 40, box["y"] + box["height"] / 2)
    page.mouse.down()
    begun = time.monotonic()
    yield
    assert time.monotonic() - begun > 1.4
    page.mouse.up()


def assert_fits(page: Page) -> None:
    """Nothing is wider than the panel, once pictures have its size."""
    fits = "() => document.documentElement.scrollWidth <= window.innerWidth"
    page.wait_for_function(fits)


def small_targets(page: Page, where: str, least_px: int) -> list[str]:
    """What is to be touched and is lower than that."""
    found = page.evaluate(
        """([selector, least]) => [...document.querySelectorAll(selector)]
            .map((e) => [e.getBoundingClientRect().height, e])
            .filter(([height, e]) => e.checkVisibility() && height < least - 0.5)
            .map(([height, e]) => `${height} px ${e.outerHTML.slice(0, 120)}`)""",
        ["button, main a, select, summary, input:not([type=file])", least_px],
    )
    return [f"{where}: {one}" for one in found]


def overlapping(page: Page, selector: str, frame: str = "html") -> list[str]:
    """Pairs of what is seen that lie over each other, and what is not in the frame."""
    return page.evaluate(
        """([selector, frame]) => {
          const boxOf = (e) => e.getBoundingClientRect();
          const whole = boxOf(document.querySelector(frame));
          const found = [...document.querySelectorAll(selector)]
            .filter((e) => e.checkVisibility() && boxOf(e).width);
          const over = (p, q) => p.left < q.right - 1 && q.left < p.right - 1
              && p.top < q.bottom - 1 && q.top < p.bottom - 1;
          const isCut = (p) => p.left < whole.left || p.right > whole.right
              || p.bottom > whole.bottom;
          return found.flatMap((a, i) => [...(isCut(boxOf(a)) ? [frame] : []),
            ...found.slice(i + 1).filter((b) =>
              !a.contains(b) && !b.contains(a) && over(boxOf(a), boxOf(b)))
              .map((b) => `${b.className} ${b.textContent}`)]
            .map((other) => `${a.className} ${a.textContent} / ${other}`));
        }""",
        [selector, frame],
    )


class Taps:
    """What an operator presses at one page, counted."""

    def __init__(self, page: Page, patience_ms: float | None = None) -> None:
        self.page, self.count, self._patience_ms = page, 0, patience_ms

    def press(self, label: str, *, where: str = NEXT) -> None:
        button = self.page.locator(where, has_text=label)
        expect(button).to_be_enabled(timeout=self._patience_ms)
        button.click()
        self.count += 1

    def hold_until(self, label: str, address: str) -> None:
        button = self.page.locator(NEXT, has_text=label)
        expect(button).to_be_enabled(timeout=self._patience_ms)
        with held(self.page, button):
            self.page.wait_for_url(address)
        self.count += 1
