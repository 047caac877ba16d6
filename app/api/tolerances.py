"""The volumetric error against tolerances: of its mean, and of the machine."""

from __future__ import annotations

from typing import Any

from truepath.app.api.models.volumetric_error import SpreadOut
from truepath.app.api.service import Service
from truepath.app.errors import NotFound
from truepath.app.results.conformity import Conformity, decide_conformity

_COVERAGE = 2.0  # k of expanded uncertainties


def find_machine_tolerance_um(service: Service, job_id: str) -> float | None:
    """Return the tolerance of the machine of a job; None where nobody knows one."""
    machine_id = service.store.get(job_id).machine
    if machine_id is None:
        return None
    try:
        return service.setup.registry.get(machine_id).tolerance_um
    except NotFound:
        return None


def hold_against(
    spread: dict[str, Any], mean_um: float | None, machine_um: float | None
) -> SpreadOut:
    """Return sizes in µm with what they are against both tolerances."""
    return SpreadOut(
        **spread,
        conformity=_decide(spread["mean"], mean_um),
        conformity_p95=_decide(spread["p95"], machine_um),
    )


def _decide(size: dict[str, float], tolerance_um: float | None) -> Conformity | None:
    if tolerance_um is None:
        return None
    expanded_um = _COVERAGE * size["uncertainty_um"]
    return decide_conformity(size["value_um"], expanded_um, tolerance_um)
