"""Draw page.png: the operator page after a calibration of the simulated machine.

Starts the real service with simulated devices in a temporary folder, does the job on
the page as an operator would, and takes the picture of the result.

    .venv/bin/python docs/figures/page.py
"""

from __future__ import annotations

import http.client
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

LOOPBACK = "127.0.0.1"
PICTURE = Path(__file__).with_name("page.png")
SIZE = {"width": 1280, "height": 1190}
SPEED = "4"
START_S = 60
STEP_MS = 30_000
JOB_MS = 240_000
NEXT = "#next button:not(:disabled)"
LARGEST_BYTES = 400_000


def main() -> None:
    """Draw the picture."""
    with _service() as address, sync_playwright() as playwright:
        found = os.environ.get("CHROMIUM") or shutil.which("chromium")
        if found is None:
            sys.exit("Chromium is missing: apt-get install chromium, or set CHROMIUM")
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page(viewport=SIZE, color_scheme="light", locale="en-GB")
        page.set_default_timeout(STEP_MS)
        page.goto(address)
        _calibrate(page)
        picture = page.screenshot()
        browser.close()
    # Flat greys: a palette halves the file and shows the same.
    colours = Image.open(io.BytesIO(picture)).convert("RGB").quantize(256)
    colours.save(PICTURE, optimize=True)
    size = PICTURE.stat().st_size
    if size > LARGEST_BYTES:
        sys.exit(f"{PICTURE.name} has {size} bytes, more than {LARGEST_BYTES}")
    print(f"{PICTURE.name}: {size} bytes")


def _calibrate(page: Page) -> None:
    """Connect, plan, start the motion, wait for the result."""
    page.locator(NEXT, has_text="Connect devices").click()
    page.locator(NEXT, has_text="Prepare the run").click()
    page.locator(".path-view[data-drawn]").wait_for()
    start = page.locator(NEXT, has_text="Hold to start motion")
    start.hover()
    page.mouse.down()
    page.wait_for_url("**/#/run/*")
    page.mouse.up()
    page.wait_for_url("**/#/result/*", timeout=JOB_MS)
    page.locator(".chart canvas").first.wait_for()
    page.mouse.move(4, 400)
    page.evaluate("document.activeElement.blur()")


@contextmanager
def _service() -> Iterator[str]:
    with socket.create_server((LOOPBACK, 0)) as free:
        port = free.getsockname()[1]
    truepath = Path(sys.executable).with_name("truepath")
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(  # noqa: S603 (our own command)
            [
                truepath,
                "serve",
                "--simulated",
                "--port",
                f"{port}",
                "--data-dir",
                folder,
            ],
            env={**os.environ, "TRUEPATH_SIMULATED_SPEED": SPEED},
            stdout=subprocess.DEVNULL,
        )
        try:
            _wait_for(port)
            yield f"http://{LOOPBACK}:{port}"
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)


def _wait_for(port: int) -> None:
    give_up = time.monotonic() + START_S
    while time.monotonic() < give_up:
        if _is_ready(port):
            return
        time.sleep(0.2)
    sys.exit(f"the service did not answer within {START_S} s")


def _is_ready(port: int) -> bool:
    link = http.client.HTTPConnection(LOOPBACK, port, timeout=1)
    try:
        link.request("GET", "/readyz")
        return link.getresponse().status == http.HTTPStatus.OK
    except OSError:
        return False
    finally:
        link.close()


if __name__ == "__main__":
    main()
