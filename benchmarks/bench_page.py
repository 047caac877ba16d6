"""The operator page while a run streams and a solve is on: first paint, taps, shifts.

usage: benchmarks/bench_page.py [--opened N] [--rounds N] [--solvers N] [--write]

A machine is measured at 500 Hz and an analysis computes beside it, over and over. The
page is opened afresh, with nothing kept from before, and then worked at: steps, inputs
on Plan, path and tables on Run. Chromium's own entries count: first-contentful-paint,
event (from the touch to the next picture), longtask and layout-shift.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench_samples_lost import feed_for, keep_bundle, measure, service, solving
from playwright.sync_api import Browser, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import write_section

DOCUMENT = Path(__file__).parents[1] / "docs" / "page.md"
SIZES = {"desk": (1280, 800), "phone": (390, 844)}
RUN_S = 900.0
PATIENCE_MS = 60_000
SETTLED_MS = 1500
PAINT_MS, TAP_MS, SHIFT = 1000.0, 100.0, 0.1  # as good as they have to be
SHORTEST_MS = 16  # Chromium tells of no quicker tap
WATCH = f"""
window.seen = {{ paint: null, shift: 0, taps: [], tasks: [] }};
const watch = (type, note, more) => new PerformanceObserver((list) =>
  list.getEntries().forEach(note)).observe({{ type, buffered: true, ...more }});
watch("paint", (entry) => {{
  if (entry.name === "first-contentful-paint") seen.paint = entry.startTime;
}});
watch("layout-shift", (entry) => {{
  if (!entry.hadRecentInput) seen.shift += entry.value;
}});
watch("longtask", (entry) => seen.tasks.push(entry.duration));
watch("event", (entry) => {{
  if (entry.interactionId) {{
    seen.taps.push([entry.interactionId, entry.duration, entry.name]);
  }}
}}, {{ durationThreshold: {SHORTEST_MS} }});
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a size of panel has shown.

    paint_ms : (n,) until its first text is seen, each time it is opened
    tap_ms : (n,) from a tap to the next picture; quicker ones count as the shortest
    task_ms : longest piece of work that kept the page from answering
    shift : sum of all layout shifts that nobody asked for, in a page's life
    """

    size: str
    paint_ms: np.ndarray
    tap_ms: np.ndarray
    task_ms: float
    shift: float
    load: float

    @property
    def is_good(self) -> bool:
        """Whether the usual panel would call it quick, by the worst but a few taps."""
        quick = np.median(self.paint_ms) < PAINT_MS
        return bool(quick and np.quantile(self.tap_ms, 0.98) < TAP_MS)


def measure_page(
    browser: Browser, address: str, job_id: str, size: str, opened: int, rounds: int
) -> Outcome:
    paint_ms, shifts, load = [], [], os.getloadavg()[0]
    for _ in range(opened):
        with open_page(browser, address, size) as page:
            seen = read(page)
            paint_ms.append(seen["paint"])
            shifts.append(seen["shift"])
    with open_page(browser, address, size) as page:
        taps = sum(work(page, job_id) for _ in range(rounds))
        page.wait_for_timeout(SETTLED_MS)
        seen = read(page)
    return Outcome(
        size,
        np.array(paint_ms),
        pad(longest(seen["taps"]), taps),
        max(seen["tasks"], default=0.0),
        max([*shifts, seen["shift"]]),
        0.5 * (load + os.getloadavg()[0]),
    )


@contextmanager
def open_page(browser: Browser, address: str, size: str) -> Iterator[Page]:
    """Open the page with an empty cache; yield it once what moves is drawn."""
    width, height = SIZES[size]
    context = browser.new_context(
        viewport={"width": width, "height": height}, has_touch=size == "phone"
    )
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.add_init_script(WATCH)
    page.goto(address)
    page.wait_for_url("**/#/run/*")
    page.locator(".path-view[data-drawn]").wait_for()
    page.wait_for_timeout(SETTLED_MS)
    yield page
    context.close()


def read(page: Page) -> dict[str, Any]:
    return page.evaluate("window.seen")


def work(page: Page, job_id: str) -> int:
    """Go through steps and inputs once; return the number of taps and keys."""
    taps = 0

    def tap(selector: str) -> None:
        nonlocal taps
        page.locator(selector).first.click()
        page.wait_for_timeout(SHORTEST_MS)
        taps += 1

    tap(".step a[href='#/plan']")
    page.wait_for_url("**/#/plan")
    for name in ("method", "details"):
        tap(f"[data-fold={name}] > summary")
    for kind in ("measure-standstill", "measure-adaptive", "measure-otf"):
        tap(f"[data-kind={kind}]")
    for field in ("#minutes", "#feed"):
        tap(field)
        page.keyboard.type("7")
        page.keyboard.press("Backspace")
        taps += 2
    tap(f".step a[href='#/run/{job_id}']")
    page.locator(".path-view[data-drawn]").wait_for()
    for button in (".run-chooser button:last-child", ".run-chooser button"):
        tap(button)
        page.wait_for_timeout(SETTLED_MS / 3)
    tap("#to-records")
    page.wait_for_url("**/#/records")
    tap("#next button")
    page.wait_for_url(f"**/#/run/{job_id}")
    return taps


def longest(events: list[tuple[int, float, str]]) -> np.ndarray:
    """Return of each interaction the event that took longest, in ms."""
    by_id: dict[int, float] = {}
    for number, duration_ms, _ in events:
        by_id[number] = max(by_id.get(number, 0.0), duration_ms)
    return np.array(sorted(by_id.values()))


def pad(told_ms: np.ndarray, taps: int) -> np.ndarray:
    """Return all taps: those that nothing was told of took the shortest time."""
    return np.append(told_ms, np.full(max(taps - len(told_ms), 0), float(SHORTEST_MS)))


def table(outcomes: list[Outcome]) -> str:
    head = (
        "| panel | first paint, median (worst) | tap to picture, median, 98 % "
        "(worst) | taps | longest task | layout shift | load |"
    )
    rows = [
        f"| {SIZES[o.size][0]} × {SIZES[o.size][1]} "
        f"| {np.median(o.paint_ms):.0f} ms ({o.paint_ms.max():.0f} ms) "
        f"| {np.median(o.tap_ms):.0f} ms, {np.quantile(o.tap_ms, 0.98):.0f} ms "
        f"({o.tap_ms.max():.0f} ms) | {len(o.tap_ms)} | {o.task_ms:.0f} ms "
        f"| {o.shift:.3f} | {o.load:.1f} |"
        for o in outcomes
    ]
    return "\n".join([head, "| --- " * 7 + "|", *rows]) + "\n"


def find_chromium() -> str:
    """Return the browser's file, or end with what to install."""
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    return found or sys.exit("Chromium is missing: install it, or set CHROMIUM")


def main() -> int:
    """Measure both sizes of panel; print, or write into the page; 1 if one is slow."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--opened", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--solvers", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"into {DOCUMENT.name}")
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="truepath-bench-") as name:
        folder = Path(name)
        bundle = keep_bundle(folder)
        with (
            sync_playwright() as playwright,
            service(folder, 500) as (client, _),
            solving(bundle, folder, options.solvers),
        ):
            browser = playwright.chromium.launch(executable_path=find_chromium())
            job_id = measure(client, feed_for(RUN_S))
            client.wait_for(job_id, "running", timeout_s=120.0)
            for size in SIZES:
                outcomes.append(
                    measure_page(
                        browser,
                        client.address,
                        job_id,
                        size,
                        options.opened,
                        options.rounds,
                    )
                )
                print(outcomes[-1], flush=True)
            browser.close()
    if options.write:
        write_section("page while running", table(outcomes), DOCUMENT)
    else:
        print(table(outcomes))
    return 0 if all(one.is_good for one in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
