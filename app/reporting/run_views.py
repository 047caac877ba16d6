"""What the report states of each Run: how it was measured, its noise, its origin."""

from __future__ import annotations

import numpy as np

from app.files.units import UM_PER_MM, URAD_PER_RAD
from app.reporting.error_figures import draw_residuals
from app.reporting.templating import View
from app.results.findings import Findings, RunFindings
from app.results.number_format import format_number

_K = 2.0
_HOW = {"otf": "on the fly", "standstill": "at standstill"}


def name_runs(findings: Findings) -> str:
    """Return the Runs and their modes in a line."""
    runs = [run.summary for run in findings.runs]
    if len(runs) == 1:
        return f"Run {runs[0].name}, measured {_HOW[runs[0].mode]}"
    named = ", ".join(f"{run.name} ({_HOW[run.mode]})" for run in runs)
    return f"Runs {named}, measured"


def describe_measurement(run: RunFindings) -> View:
    """Return how a Run was measured."""
    summary, estimate = run.summary, run.estimate
    return {
        "name": summary.name,
        "mode": summary.mode,
        "feed": _state_feed(summary.feed_mm_min),
        "commanded": summary.lines,
        "recognised": estimate.lines,
        "minutes": f"{summary.measured_s / 60.0:.1f}",
        "samples": f"{estimate.offered_samples:,}",
        "used": 100.0 * estimate.used_samples / max(estimate.offered_samples, 1),
        "cells": f"{estimate.cells:,}",
        "distance_m": f"{run.noise.distance_mm / 1000.0:.2f}",
        "rate_hz": f"{estimate.tracker.rate_hz:g}",
        "stands_on": estimate.tracker.stands_on,
        "temperatures": ", ".join(
            f"{sensor} {low:.2f} to {high:.2f} °C"
            for sensor, (low, high) in summary.temperature_degc.items()
        ),
    }


def describe_run_residuals(run: RunFindings) -> View:
    """Return the residuals of a Run, and its noise."""
    noise, jitter = run.noise, run.noise.along_travel_um
    parts = (
        ("One sample, as the tracker states", noise.stated_um),
        ("One sample, white part found", noise.white_um),
        ("Correlated part found", noise.ou_um),
    )
    return {
        "name": run.summary.name,
        "mode": run.summary.mode,
        "figure": draw_residuals(run),
        "noise": [
            (name, *(format_number(v, 2) for v in values)) for name, values in parts
        ],
        "distance_m": f"{noise.distance_mm / 1000.0:.2f}",
        "correlation_time_s": f"{noise.ou_time_s:.2g}",
        "along_um": None if jitter is None else f"{jitter:.2g}",
    }


def describe_origin(run: RunFindings, *, across_only: bool) -> View:
    """Return which data of a Run were used, and where the tracker stood."""
    sigma = np.sqrt(np.maximum(np.diag(run.estimate.pose_covariance), 0.0))
    scale = _K * np.repeat([UM_PER_MM, URAD_PER_RAD], 3)
    half = [f"{value:.2g}" for value in scale * sigma]
    station = run.estimate.pose.invert().translation_mm.tolist()
    return {
        "name": run.summary.name,
        "mode": run.summary.mode,
        "digest": run.summary.digest,
        "source": run.summary.source,
        "across_only": across_only,
        "station_mm": ", ".join(format_number(value) for value in station),
        "translation_um": ", ".join(half[:3]),
        "rotation_urad": ", ".join(half[3:]),
    }


def _state_feed(feed_mm_min: tuple[float, float] | None) -> str:
    if feed_mm_min is None:
        return ""
    return " to ".join(dict.fromkeys(f"{feed:,.0f}" for feed in feed_mm_min))
