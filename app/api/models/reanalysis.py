"""Many Runs analysed again, as clients see them."""

from __future__ import annotations

from pydantic import BaseModel, Field

from truepath.app.files.verdict import State as VerdictState


class RunFigures(BaseModel):
    """What a result of a Run states in short."""

    verdict: VerdictState | None
    volumetric_error_um: float = Field(
        description="Mean length of the volumetric error over the travel."
    )
    uncertainty_um: float = Field(description="Its standard uncertainty (k = 1).")


class RunFailure(BaseModel):
    """Why a Run has no result."""

    family: str = Field(examples=["AlignmentError"])
    detail: str


class ReanalysedRun(BaseModel):
    """One Run before and after; `before` is of the newest job of that Run alone."""

    run_id: str
    name: str
    truepath: str = Field(description="Version that has analysed it.")
    before_job: str | None
    before: RunFigures | None
    after: RunFigures | None
    failure: RunFailure | None
    took_s: float


class ReanalysisOut(BaseModel):
    """What has become of every Run."""

    schema_: str = Field(alias="schema", examples=["reanalysis/1"])
    truepath: str
    total: int
    analysed: int
    failed: int
    compared: int = Field(description="Runs that have a result before and after.")
    unchanged: int = Field(description="Of these, the same volumetric error.")
    largest_change_um: float | None
    verdict_changes: dict[str, int] = Field(examples=[{"usable -> doubtful": 2}])
    analyses: list[ReanalysedRun]
