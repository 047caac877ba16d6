"""How far measured and simulated lie apart on lines that were held out of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.alignment.reduction import beam_frame
from app.discovery.term_fitter import TermFit
from app.estimation.line_blocks import RunData
from app.estimation.noise import floor_mm


@dataclass(frozen=True)
class Gap:
    """Weighted root mean square of measured minus simulated on held-out lines.

    expected_um : what a complete model would leave there: noise, and the uncertainty
        of a fit to the other lines
    """

    before_um: float
    after_um: float
    noise_floor_um: float
    expected_um: float


def measure_gap(run_data: Sequence[RunData], baseline: TermFit, best: TermFit) -> Gap:
    """Return the gap; with a fast effect, of the samples within cells as well."""
    floor_um = _noise_floor_um(run_data)
    fast = any(term.is_fast for term in best.terms)
    return Gap(
        floor_um * baseline.held_out.ratio(fast=fast),
        floor_um * best.held_out.ratio(fast=fast),
        floor_um,
        floor_um * best.held_out.expected(fast=fast),
    )


def _noise_floor_um(run_data: Sequence[RunData]) -> float:
    """Return the root mean square that noise alone leaves in a cell of all Runs."""
    square, cells = 0.0, 0
    for seen, base in ((run.observations, run.base) for run in run_data):
        frame = beam_frame(seen.tracker_mm) @ base.pose.rotation
        along = np.einsum("nij,nj->ni", frame, seen.direction)
        square += len(seen) * floor_mm(seen, base.noise, along) ** 2
        cells += len(seen)
    return 1e3 * float(np.sqrt(square / cells))
