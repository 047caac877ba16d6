"""What the report says of each Run: how it was measured, its noise, its origin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from app.reporting.figures import residual_figure
from app.reporting.html_parts import drawing, escape, facts, table
from app.results.error_tables import MICRO, MILLI
from app.results.findings import Findings, RunFindings
from app.results.numbers_as_text import plain

_K = 2.0
_HOW = {"otf": "on the fly", "standstill": "at standstill"}


def measured_how(found: Findings) -> str:
    """Name the Runs and their modes in a line."""
    runs = [run.account for run in found.runs]
    if len(runs) == 1:
        return f"Run {escape(runs[0].name)}, measured {_HOW[runs[0].mode]}"
    named = ", ".join(f"{escape(run.name)} ({_HOW[run.mode]})" for run in runs)
    return f"Runs {named}, measured"


def each_run(found: Findings, said: Callable[[RunFindings], str]) -> str:
    """Say something of each Run, under its name where there are several."""
    if len(found.runs) == 1:
        return said(found.main)
    return "".join(
        f"<h3>Run {escape(run.account.name)}</h3>{said(run)}" for run in found.runs
    )


def measurement(run: RunFindings) -> str:
    """Say how a Run was measured."""
    account, estimate = run.account, run.estimate
    used = 100.0 * estimate.used_samples / max(estimate.offered_samples, 1)
    things = "lines" if account.mode == "otf" else "points"
    pairs = [
        ("Mode", _mode(run)),
        ("Commanded", f"{account.lines} {things}, {estimate.lines} of them recognised"),
        ("Measuring time", f"{account.measured_s / 60.0:.1f} min"),
        (
            "Samples",
            f"{estimate.offered_samples:,} recorded, {used:.0f} % used, reduced to "
            f"{estimate.cells:,} cells",
        ),
        ("Tracker", _tracker(run)),
    ]
    if account.temperature_degc:
        pairs.append(("Temperature", _temperature(account.temperature_degc)))
    return facts(pairs)


def residuals(run: RunFindings) -> str:
    """Show what the model leaves of a Run, and the noise that was found."""
    noise = run.noise
    head = ("Standard deviation, µm", "along the beam", "across the beam")
    rows = [
        (name, *(plain(v, 2) for v in values))
        for name, values in (
            ("One sample, as the tracker states", noise.stated_um),
            ("One sample, white part found", noise.white_um),
            ("Correlated part found", noise.ou_um),
        )
    ]
    return (
        drawing(
            residual_figure(run),
            "Root mean square of one residual component on each row, and the "
            "distribution over all cells in the frame of the beam.",
        )
        + table(head, rows, numbers=1)
        + f"<p class=note>At the mean distance of {noise.distance_mm / 1000.0:.2f} m. "
        f"The correlated part fades with {noise.ou_time_s:.2g} s; samples are never "
        f"counted as independent within it. {_along(run)}</p>"
    )


def origin(run: RunFindings, *, across_only: bool) -> str:
    """State which data of a Run were used, and where the tracker stood."""
    account = run.account
    along = (
        "across the travel only"
        if across_only
        else "across the travel, and along it with phase and speed of each line free"
    )
    pairs = [
        ("Run", escape(account.name)),
        ("Input, SHA-256", f"<code>{account.digest}</code>"),
        *((escape(k), f"<code>{escape(v)}</code>") for k, v in account.source.items()),
        ("Deviations used", along if account.mode == "otf" else "all directions"),
        ("Tracker pose", _pose(run)),
    ]
    return facts(pairs)


def _mode(run: RunFindings) -> str:
    feed = run.account.feed_mm_min
    if feed is None:
        return "standstill points"
    low, high = feed
    speed = f"{low:,.0f}" if low == high else f"{low:,.0f} to {high:,.0f}"
    return f"on the fly at {speed} mm/min"


def _tracker(run: RunFindings) -> str:
    tracker = run.estimate.tracker
    distance = run.noise.distance_mm / 1000.0
    return (
        f"{distance:.2f} m from the tool on average, {tracker.rate_hz:g} samples a "
        f"second, standing on the {tracker.stands_on}"
    )


def _temperature(seen: dict[str, tuple[float, float]]) -> str:
    return ", ".join(
        f"{escape(name)} {low:.2f} to {high:.2f} °C"
        for name, (low, high) in seen.items()
    )


def _along(run: RunFindings) -> str:
    jitter = run.noise.along_travel_um
    if run.account.mode != "otf":
        return ""
    if jitter is None:
        return "What lies along the travel was not used."
    return f"Along the travel the feed scatters by {jitter:.2g} µm a cell."


def _pose(run: RunFindings) -> str:
    sigma = _K * np.sqrt(np.maximum(np.diag(run.estimate.pose_covariance), 0.0))
    shift = ", ".join(f"{v:.2g}" for v in MILLI * sigma[:3])
    turn = ", ".join(f"{v:.2g}" for v in MICRO * sigma[3:])
    place = ", ".join(
        plain(v) for v in run.estimate.pose.invert().translation_mm.tolist()
    )
    return (
        f"tracker at ({place}) mm in the workpiece frame; U (k = 2) of the pose "
        f"({shift}) µm and ({turn}) µrad"
    )
