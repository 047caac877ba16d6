"""The volumetric error of a result: its size held against a tolerance, and its map."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from truepath.app.api.models.base import JOB_ID
from truepath.app.files.verdict import State as VerdictState
from truepath.app.results.conformity import Conformity

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_POSITIONS = [[0.0, 0.0, 0.0], [0.0, 0.0, 62.5]]


class SizeOut(BaseModel):
    """A length in µm with its standard uncertainty (k = 1)."""

    value_um: float = Field(examples=[15.32])
    uncertainty_um: float = Field(examples=[0.11])
    scale_uncertainty_um: float | None = Field(
        None,
        description="The part of it that comes from the scale of all lengths, of air "
        "and tracker. Earlier results do not have it, nor the scale in their sum.",
        examples=[0.07],
    )


class SpreadOut(BaseModel):
    """Length of the volumetric error over the travel."""

    mean: SizeOut
    p95: SizeOut = Field(description="Below it lie 95 % of the places.")
    largest: SizeOut
    conformity: Conformity | None = Field(
        description="Of the mean by ISO 14253-1 with k = 2; null without a tolerance."
    )
    conformity_p95: Conformity | None = Field(
        description="Of `p95` against the tolerance of the machine, by ISO 14253-1 "
        "with k = 2; null where the machine has none."
    )


class VolumetricErrorOfResult(BaseModel):
    """The volumetric error before, and as full compensation is expected to leave it."""

    job_id: str = Field(examples=[JOB_ID])
    verdict: VerdictState = Field(description="Of the result.")
    tolerance_um: float | None = Field(description="Of the mean, as asked for.")
    machine_tolerance_um: float | None = Field(
        description="What 95 % of the places in the travel of the machine may err by "
        "at most, as it is set now; null where it has no tolerance.",
        examples=[15.0],
    )
    before: SpreadOut
    after_expected: SpreadOut
    on: str = Field(description="Where it was computed, in words.")


class VolumetricMapOut(BaseModel):
    """The volumetric error on a grid over the travel, mean of both directions.

    Without the rigid motion of the whole volume. Uncertainties are standard ones.
    """

    job_id: str = Field(examples=[JOB_ID])
    state: Literal["before", "after"]
    compensation: str | None = Field(
        description="Kept files whose correction it is; null for a full correction.",
        examples=["linuxcnc-10-hold"],
    )
    verdict: VerdictState = Field(description="Of the result.")
    target: str = Field(description="Whose error it is; empty where it has no name.")
    points: int = Field(description="An axis.", examples=[9])
    axes: list[str] = Field(examples=[["X", "Y", "Z"]])
    position: list[list[float]] = Field(
        description="mm for linear axes, X slowest; rotary axes rest at their zero.",
        examples=[_POSITIONS],
    )
    error_um: list[Vector] = Field(
        description="δ = actual − nominal as far as it is known; 0 after a full "
        "correction.",
        examples=[[[4.1, -2.2, 0.6], [3.9, -2.4, 0.9]]],
    )
    uncertainty_um: list[Vector] = Field(examples=[[[0.3, 0.3, 0.2]]])
    length_um: list[float] = Field(
        description="Of the error; after compensation the expected one of what is "
        "left, over the errors that the measurement allows.",
        examples=[[4.69, 4.67]],
    )
    is_measured: list[bool] = Field(
        description="False far beyond what was measured: extrapolated.",
        examples=[[True, True]],
    )
