"""The reports are of the estimates that the tests of results construct."""

from results_fixtures import (
    across_only,
    construct,
    estimate,
    found,
    load,
    loaded,
    provenance,
    three_targets,
    with_residuals,
)

__all__ = [
    "across_only",
    "construct",
    "estimate",
    "found",
    "load",
    "loaded",
    "provenance",
    "three_targets",
    "with_residuals",
]
