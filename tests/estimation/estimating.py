"""The batch estimate as an analysis makes it, from observations alone."""

from __future__ import annotations

from truepath.estimation.problem.known_effects import KnownEffects
from truepath.estimation.solve import batch
from truepath.files.bundle.one_machine import one_machine
from truepath.kinematics.coarse_model import build_run_models


def estimate(*observed, names=(), known=None, **options):
    """Estimate from the observations of some Runs of one machine."""
    names = names or [f"Run {number}" for number in range(1, len(observed) + 1)]
    machine = one_machine([each.at.machine for each in observed], names)
    known = known or KnownEffects()
    models = build_run_models(
        machine, [each.at.offset_mm for each in observed], known.effects
    )
    return batch.estimate(models, observed, known=known, **options)
