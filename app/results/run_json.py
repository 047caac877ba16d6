"""What `result.json` says of each Run that an estimate was made from."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from app.files.units import UM_PER_MM, URAD_PER_RAD
from app.results.findings import RunFindings


def run_json(run: RunFindings) -> dict[str, Any]:
    """Return one element of `runs`."""
    summary, residuals = run.summary, run.estimate.residuals
    return {
        "name": summary.name,
        "mode": summary.mode,
        "samples": run.estimate.offered_samples,
        "used_samples": run.estimate.used_samples,
        "measured_s": summary.measured_s,
        "feed_mm_min": list(summary.feed_mm_min) if summary.feed_mm_min else None,
        "input_sha256": summary.digest,
        "source": summary.source,
        "alignment": alignment_json(run),
        "residuals": {
            "rms_um": UM_PER_MM * residuals.rms_mm,
            "noise_floor_um": UM_PER_MM * residuals.floor_mm,
            "by_direction_um": by_direction_json(residuals.residual_mm),
            "by_line": lines_json(run),
        },
        "noise": noise_json(run),
    }


def alignment_json(run: RunFindings) -> dict[str, Any]:
    """Return where the tracker stood, and what of the commanded rows was found."""
    summary, estimate = run.summary, run.estimate
    sigma = np.sqrt(np.maximum(np.diag(estimate.pose_covariance), 0.0))
    first = 1 if summary.mode == "otf" else 0
    rows = set(range(first, first + summary.lines))
    return {
        "pose": {
            "from": "workpiece",
            "to": "tracker",
            "rotation": estimate.pose.rotation.tolist(),
            "shift_mm": estimate.pose.translation_mm.tolist(),
        },
        "pose_uncertainty": {
            "about_mm": estimate.centre_mm.tolist(),
            "shift_um": (UM_PER_MM * sigma[:3]).tolist(),
            "turn_urad": (URAD_PER_RAD * sigma[3:]).tolist(),
        },
        "lines": summary.lines,
        "matched_lines": estimate.lines,
        "rows_without_data": sorted(rows - set(run.by_line.row.tolist())),
        "cells": estimate.cells,
        "samples": estimate.offered_samples,
        "used_samples": estimate.used_samples,
    }


def by_direction_json(residual_mm: Float64[np.ndarray, "n 3"]) -> dict[str, float]:
    """Return the root mean square of each component in the frame of the beam."""
    beam = UM_PER_MM * np.sqrt(np.mean(residual_mm**2, axis=0))
    return dict(zip(("beam", "azimuth", "elevation"), beam.tolist(), strict=True))


def lines_json(run: RunFindings) -> list[dict[str, Any]]:
    """Return the residuals of each row of the path or points."""
    lines = run.by_line
    return [
        {"row": int(row), "cells": int(cells), "rms_um": float(rms)}
        for row, cells, rms in zip(lines.row, lines.cells, lines.rms_um, strict=True)
    ]


def noise_json(run: RunFindings) -> dict[str, Any]:
    """Return the noise that was found in a Run."""
    noise, known = run.noise, ("along_beam", "across_beam")
    return {
        "distance_mm": noise.distance_mm,
        "stated_um": dict(zip(known, noise.stated_um.tolist(), strict=True)),
        "white_um": dict(zip(known, noise.white_um.tolist(), strict=True)),
        "slow_um": dict(zip(known, noise.ou_um.tolist(), strict=True)),
        "slow_time_s": noise.ou_time_s,
        "along_travel_um": noise.along_travel_um,
    }
