"""Draw certificate.png: the first pages of a certificate of a simulated machine.

Records a machine as the simulators do, analyses it, and shows the certificate's HTML as
it is printed.

    .venv/bin/python docs/figures/certificate.py
"""

from __future__ import annotations

import io
import os
import shutil
import sys
import tempfile
from datetime import date
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from truepath.answers.calibration_report import render_analysis, write_analysis
from truepath.answers.certificate.document import render_certificate
from truepath.answers.certificate.issue import Certificate, read_result_source
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.results.analysis import analyse
from truepath_drivers.interfaces.records import Path as CommandedPath
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic

PICTURE = Path(__file__).with_name("certificate.png")
PAGE = {"width": 720, "height": 1000}
LARGEST_BYTES = 400_000
IDENTITY = {
    "machine_maker": "Example Machine Works",
    "serial_number": "4711",
    "tracker": "simulated tracker",
    "operator": "A. Weiß",
    "place": "Hall 3",
    "warm_up": "2 h, axes moving",
}


def main() -> None:
    """Draw the picture."""
    with tempfile.TemporaryDirectory() as folder:
        write_analysis(render_analysis(analyse(_record())), folder)
        source = read_result_source(Path(folder) / "result.json")
    issued = date(2026, 11, 24)
    html = render_certificate(Certificate(source, issued, identity=IDENTITY))
    pictures = _show(html)
    both = Image.new("RGB", (sum(p.width for p in pictures), PAGE["height"]), "white")
    for number, picture in enumerate(pictures):
        both.paste(picture, (number * PAGE["width"], 0))
    both.quantize(128).save(PICTURE, optimize=True)
    size = PICTURE.stat().st_size
    if size > LARGEST_BYTES:
        sys.exit(f"{PICTURE.name} has {size} bytes, more than {LARGEST_BYTES}")
    print(f"{PICTURE.name}: {size} bytes")


def _record() -> Run:
    content = load_machine("demo")
    program = paths.chord_path(parse_machine(content), 1, 40, 10_000.0)
    made = synthetic.record(content, program, 1, "otf", None)
    machine, count = machine_from_json(content, file="machine.json"), len(made)
    commanded = CommandedPath(
        machine.axis_names, program.position, 60.0 * program.feed_mm_s, program.dwell_s
    )
    stream = TrackerSamples(
        np.arange(count), made.time_s, made.position_mm, made.status
    )
    return Run("demo", machine, commanded, stream)


def _show(html: str) -> list[Image.Image]:
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if found is None:
        sys.exit("Chromium is missing: apt-get install chromium, or set CHROMIUM")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page(viewport=PAGE, color_scheme="light")
        page.set_content(html)
        box = page.locator("#setup").bounding_box()
        begins = [0.0, box["y"] if box else float(PAGE["height"])]
        shots = [
            page.screenshot(full_page=True, clip={"x": 0, "y": begin, **PAGE})
            for begin in begins
        ]
        browser.close()
    return [Image.open(io.BytesIO(shot)).convert("RGB") for shot in shots]


if __name__ == "__main__":
    main()
