"""Takes the pictures of page.md, and that of the README, of the real operator page.

Starts the service with simulated devices in a temporary folder and does a whole
calibration on the page as an operator would; what takes long is waited for by the
client. A second service, whose machine has a fault that the model lacks, is for the
step Discover. All panels follow the same job: English, German, and a German phone.

python docs/take_pictures.py [--only calibration | --only discovery] [--whole FOLDER]
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from truepath.client import Client

FIGURES = Path(__file__).with_name("figures")
SPEED = "2"
# Large enough that every seed of the simulated machine shows it.
FAULT = '{"name": "backlash", "axis": "X", "width_um": 8}'
WIDE, TALL, PHONE = (1280, 800), (1280, 1190), (390, 844)
COLOURS = 128
DARK = 100  # of 255: text
LARGEST_BYTES, LARGEST_SUM_BYTES = 400_000, 3_000_000
PATIENCE_MS = 120_000
COURSE_MS = 2500  # of points, until the scope has a course
JOB_S = 600.0
TOLERANCE_UM = "8"
TITLES = {"en": "Calibration certificate", "de": "Kalibrierschein"}
NEXT = "#next button:not(:disabled)"
# Below the bar, which stays where it is.
SCROLL = "e => scrollTo(0, e ? e.getBoundingClientRect().top + scrollY - 104 : 0)"
DRAWN = "[data-drawn]"
HOLD = f"{NEXT}.hold"
WHO = {
    "name": "Mill 3",
    "maker": "Example Machine Works",
    "model": "VMC 500",
    "serial_number": "4711",
    "control": "ISG kernel",
    "customer": "Example Ltd",
    "place": "Hall 3",
}


@dataclass(frozen=True)
class Panel:
    """A page in a language and a size; its name ends those of its pictures."""

    page: Page
    name: str
    whole: Path | None

    def open(self, address: str, *awaited: str) -> None:
        """Go to an address of the page and wait until what it shows is there."""
        self.page.evaluate("address => { location.hash = address; }", address)
        self.page.wait_for_url(f"**/{address}")
        for selector in awaited:
            self.page.locator(selector).first.wait_for()

    def take(self, step: str, *, top: str = "") -> None:
        """Take the picture of a step: its beginning, or from `top` on."""
        self.page.evaluate("document.activeElement.blur()")
        self.page.mouse.move(2, 300)
        element = self.page.query_selector(top) if top else None
        self.page.evaluate(SCROLL, element)
        name = f"{step}-{self.name}.png"
        _save(self.page.screenshot(animations="disabled"), FIGURES / "page" / name)
        if self.whole and not step.startswith("run"):  # a Run does not wait
            self.page.screenshot(path=self.whole / name, full_page=True)


@dataclass(frozen=True)
class Desk:
    """The panels that look at one service, and a client of it."""

    client: Client
    panels: tuple[Panel, ...]

    @property
    def first(self) -> Page:
        """The page at which the operator works; the others look on."""
        return self.panels[0].page

    def take(self, step: str, address: str, *awaited: str, phone: bool = False) -> None:
        """Take the picture of a step on all panels; on the phone where it is asked."""
        for panel in self.panels:
            if phone or panel.name != "de-phone":
                panel.open(address, *awaited)
                panel.take(step)


def main() -> None:
    """Take all pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--whole", type=Path, help="folder for pictures of whole pages")
    parser.add_argument("--only", choices=["calibration", "discovery"])
    arguments = parser.parse_args()
    whole, only = arguments.whole, arguments.only
    for folder in (FIGURES / "page", whole):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_find_chromium())
        if only != "discovery":
            with _open_desk(browser, whole) as desk:
                _calibrate(desk)
        if only != "calibration":
            with _open_desk(browser, whole, "--hide", FAULT) as desk:
                _discover(desk)
        browser.close()
    _check_sizes()


def _calibrate(desk: Desk) -> None:
    """Do a calibration from the first look to the certificate."""
    _prepare(desk)
    job = desk.first.url.rsplit("/", 1)[1]
    desk.take("check", f"#/check/{job}", DRAWN, HOLD, phone=True)
    _run(desk, job)
    desk.client.wait_for(job, timeout_s=JOB_S)
    desk.take("result", f"#/result/{job}", ".chart canvas", DRAWN, phone=True)
    _take_readme(desk.panels[0])
    _correct(desk, job)
    _verify(desk, job)
    _certify(desk, job)
    desk.take("machine-after", "#/machine", f"text={WHO['serial_number']}")
    desk.take("records", "#/records", "td.number:has-text('±')")


def _prepare(desk: Desk) -> None:
    """Choose the machine, connect, plan."""
    desk.take("machine", "#/machine", "[data-card=who]")
    desk.first.locator(NEXT).click()
    desk.first.locator(NEXT, has_text="Connect").click()
    desk.first.wait_for_url("**/#/plan")
    for panel in desk.panels[1:]:
        panel.page.reload()
    desk.take("connect", "#/connect", ".conditions li")
    for panel in desk.panels[:2]:
        panel.open("#/plan")
        panel.page.locator("[data-card=curve] .handle").wait_for()
        panel.page.locator(".curve-space[data-drawn]").wait_for()
        panel.take("plan", top="[data-card=curve]")
    desk.first.locator(NEXT).click()
    desk.first.wait_for_url("**/#/check/*")


def _run(desk: Desk, job: str) -> None:
    """Start the motion by hand and take pictures while it lasts."""
    desk.panels[0].open(f"#/check/{job}")
    desk.first.locator(HOLD).hover()
    desk.first.mouse.down()
    desk.first.wait_for_url(f"**/#/run/{job}")
    desk.first.mouse.up()
    for panel in desk.panels:
        panel.open("#/machine")
    _wait_for_share(desk.client, job, 0.2)
    for panel in desk.panels:
        panel.open(f"#/run/{job}", DRAWN)
        panel.page.wait_for_timeout(COURSE_MS)
        panel.take("run")
        if panel.name != "de-phone":
            panel.page.locator(".run-chooser button").last.click()
            panel.page.locator(".estimate-content canvas").first.wait_for()
            panel.take("run-tables")
        # Several pictures in space that move at one time are slow to draw.
        panel.open("#/machine")


def _wait_for_share(client: Client, job: str, share: float) -> None:
    while True:
        progress = client.get_job(job)["progress"]
        done = progress["done"] if progress["unit"] == "lines" else 0
        if done and done >= share * progress["total"]:
            return
        time.sleep(0.1)


def _correct(desk: Desk, job: str) -> None:
    """Make the files of a control and give the simulated one of the machine these."""
    page = desk.first
    desk.panels[0].open(f"#/export/{job}")
    page.locator("[data-format=isg-csv]").click()
    page.locator("[data-load]").first.click()
    page.locator("[data-unload]").wait_for()
    for panel in desk.panels[:2]:
        panel.open(f"#/export/{job}")
        panel.page.locator("[data-format=isg-csv]").click()
        panel.page.locator("[data-card=export] .downloads").wait_for()
        panel.page.locator("[data-unload]").wait_for()
        panel.take("export")


def _verify(desk: Desk, job: str) -> None:
    """Drive points that the result was not made from, with the files in the control."""
    for panel in reversed(desk.panels[:2]):
        panel.open(f"#/verify/{job}", "#verify-tolerance")
        panel.page.locator("[data-kind=diagonals]").click()  # they take minutes
        panel.page.locator("#verify-tolerance").fill(TOLERANCE_UM)
        chosen = panel.page.locator("#verify-files option:checked:not([value=''])")
        chosen.wait_for(state="attached")
        panel.take("verify")
    desk.first.locator(NEXT).click()
    desk.first.wait_for_url("**/#/check/*")
    proof = desk.first.url.rsplit("/", 1)[1]
    desk.client.arm(desk.client.wait_for(proof, "ready", timeout_s=JOB_S))
    desk.client.wait_for(proof, timeout_s=JOB_S)
    desk.take("verdict", f"#/verify/{proof}", ".proof")


def _certify(desk: Desk, job: str) -> None:
    """Issue the certificate in the language of the panel."""
    for panel in desk.panels[:2]:
        panel.page.reload()
        panel.open(f"#/certificate/{job}", "[data-card=stated]", NEXT)
        panel.page.locator("#state-operator").fill("A. Weiß")
        panel.page.locator(NEXT).click()
        frame = panel.page.frame_locator("iframe.preview")
        frame.locator("h1", has_text=TITLES[panel.name]).wait_for()
        _wait_for_paint(panel.page)
        panel.take("certificate")


def _wait_for_paint(page: Page) -> None:
    """Take pictures of the certificate's frame until it is more than an empty sheet."""
    frame = page.locator("iframe.preview")
    while True:
        seen = Image.open(io.BytesIO(frame.screenshot())).convert("L")
        width, height = seen.size
        inside = seen.crop((8, 8, width - 8, height // 2))
        if inside.getextrema()[0] < DARK:
            return
        time.sleep(0.5)


def _discover(desk: Desk) -> None:
    """Measure a machine that has what the model lacks, and have it named."""
    client = desk.client
    client.connect()
    order = client.create_job(kind="measure-otf")
    client.arm(client.wait_for(order["id"], "ready", timeout_s=JOB_S))
    measured = client.wait_for(order["id"], timeout_s=JOB_S)
    found = client.create_job(kind="discover", run_id=measured["run_id"])
    client.wait_for(found["id"], timeout_s=JOB_S)
    for panel in desk.panels:
        panel.page.reload()
    desk.take("discover", f"#/discover/{found['id']}", ".gap")


def _take_readme(panel: Panel) -> None:
    """Take the README's picture: more of the result than a step's shows."""
    page = panel.page
    page.set_viewport_size({"width": TALL[0], "height": TALL[1]})
    page.reload()
    page.locator(".chart canvas").first.wait_for()
    page.locator(DRAWN).first.wait_for()
    _save(page.screenshot(animations="disabled"), FIGURES / "page.png")
    page.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})


def _save(picture: bytes, file: Path) -> None:
    # Flat greys: a palette halves the file and shows the same.
    colours = Image.open(io.BytesIO(picture)).convert("RGB").quantize(COLOURS)
    colours.save(file, optimize=True)
    print(f"{file.name}: {file.stat().st_size} bytes", flush=True)


def _check_sizes() -> None:
    sizes = {file: file.stat().st_size for file in (FIGURES / "page").glob("*.png")}
    large = [file.name for file, size in sizes.items() if size > LARGEST_BYTES]
    if large or sum(sizes.values()) > LARGEST_SUM_BYTES:
        sys.exit(f"too large: {', '.join(large) or sum(sizes.values())}")


@contextmanager
def _open_desk(browser: Browser, whole: Path | None, *options: str) -> Iterator[Desk]:
    with _service(*options) as address, Client(address) as client:
        client.change_machine("default", **WHO)
        panels = tuple(
            Panel(_open_page(browser, address, language, size, scheme), name, whole)
            for name, language, size, scheme in (
                ("en", "en-GB", WIDE, "light"),
                ("de", "de-DE", WIDE, "light"),
                ("de-phone", "de-DE", PHONE, "dark"),
            )
        )
        yield Desk(client, panels)
        for panel in panels:
            panel.page.context.close()


def _open_page(
    browser: Browser, address: str, language: str, size: tuple[int, int], scheme: str
) -> Page:
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]},
        color_scheme="dark" if scheme == "dark" else "light",
        locale=language,
    )
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.goto(address)
    page.locator("#main > *").first.wait_for()
    return page


def _find_chromium() -> str:
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if found is None:
        sys.exit("Chromium is missing: apt-get install chromium, or set CHROMIUM")
    return found


@contextmanager
def _service(*options: str) -> Iterator[str]:
    truepath = Path(sys.executable).with_name("truepath")
    with tempfile.TemporaryDirectory() as folder:
        command = [truepath, "serve", "--simulated", "--port", "0"]
        process = subprocess.Popen(  # noqa: S603 (our own command)
            [*command, "--data-dir", folder, *options],
            env=os.environ
            | {"TRUEPATH_SIMULATED_SPEED": SPEED, "TRUEPATH_LOG_LEVEL": "warning"},
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield _read_address(process.stdout or iter(()))
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=60)


def _read_address(lines: Iterator[str]) -> str:
    """Return the address that the service prints; what it says later is let go."""
    for line in lines:
        words = line.split()
        if words[:1] == ["page"]:
            Thread(target=lambda: [None for _ in lines], daemon=True).start()
            return words[1].rstrip("/")
    sys.exit("the service did not start")


if __name__ == "__main__":
    main()
