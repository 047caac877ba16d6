"""A result that would hardly make the machine better says so."""

from dataclasses import replace

import pytest

from truepath.results.verdict import judge_gain
from truepath.results.volumetric_error import (
    VolumetricError,
    compute_volumetric_error,
)


def scaled(found: VolumetricError, left_um: float) -> VolumetricError:
    """Return it with another expected mean error after the compensation."""
    mean = replace(found.after.mean, value_um=left_um)
    return replace(found, after=replace(found.after, mean=mean))


@pytest.mark.parametrize(
    ("share", "state"),
    [(0.1, "usable"), (0.4, "doubtful"), (0.7, "doubtful"), (1.2, "not-usable")],
)
def test_what_is_left_is_held_against_what_was_found(estimate, share, state):
    found = compute_volumetric_error(estimate)
    verdict = judge_gain(scaled(found, share * found.before.mean.value_um))
    assert verdict.state == state
    assert [reason.kind for reason in verdict.reasons] == (
        [] if state == "usable" else ["little-gained"]
    )
