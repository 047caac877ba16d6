"""A result against a direct measurement, as `comparison.json` states it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from truepath.app.api.models.base import AsKept, Links
from truepath.app.api.models.tables import VerdictOut

Kind = Literal["positioning", "straightness", "turns"]
Numbers = float | list[float]
Directed = list[float | None]


class ComparisonLinks(Links):
    """Where a comparison is."""

    self: Annotated[str, "/jobs/{job}/comparisons/{id}"]
    report_html: Annotated[str, "/jobs/{job}/comparisons/{id}/report.html"]


class ComparedColumnsOut(BaseModel):
    """What both state, µm or µrad: of each position, or of the one number."""

    result_um: Numbers | None = None
    result_urad: Numbers | None = None
    result_uncertainty_um: Numbers | None = None
    result_uncertainty_urad: Numbers | None = None
    reference_um: Numbers | None = None
    reference_urad: Numbers | None = None
    reference_uncertainty_um: Numbers | None = None
    reference_uncertainty_urad: Numbers | None = None
    difference_um: Numbers | None = None
    difference_urad: Numbers | None = None
    combined_uncertainty_um: Numbers | None = None
    combined_uncertainty_urad: Numbers | None = None
    en: Numbers = Field(description="The difference over its expanded uncertainty.")


class ComparedErrorOut(ComparedColumnsOut):
    """An error motion along its axis."""

    position_mm: list[float] | None = None
    position_deg: list[float] | None = None
    forward_um: Directed | None = None
    forward_urad: Directed | None = None
    backward_um: Directed | None = None
    backward_urad: Directed | None = None
    largest_difference_um: float | None = None
    largest_difference_urad: float | None = None
    mean_difference_um: float | None = None
    mean_difference_urad: float | None = None
    largest_en: float
    share_within: float = Field(description="Of the positions: |en| at most 1.")
    merged: list[str] = Field(
        description="Error motions whose share is merged into the direct values."
    )
    missing: list[str] = Field(
        description="Those whose share the reference does not know."
    )


class ComparedKindOut(BaseModel):
    """All error motions of a kind."""

    motions: int
    largest_difference_um: float | None = None
    largest_difference_urad: float | None = None
    mean_difference_um: float | None = None
    mean_difference_urad: float | None = None
    largest_expanded_um: float | None = None
    largest_expanded_urad: float | None = None
    share_within: float


class ComparedVolumeOut(BaseModel):
    """Volumetric errors by what both know, over the range of the reference."""

    points: int
    result_mean_um: float
    reference_mean_um: float
    difference_mean_um: float
    difference_largest_um: float
    note: str


class ComparisonOut(BaseModel):
    """A result less a direct measurement; uncertainties are standard ones (k = 1)."""

    id: str
    schema_: Literal["comparison/1"] = Field(alias="schema")
    machine: str
    result: str
    reference: str
    verdict: Annotated[dict[str, Any], AsKept(VerdictOut)] = Field(
        description="That of the result."
    )
    convention: str
    errors: dict[str, Annotated[dict[str, Any], AsKept(ComparedErrorOut)]] = Field(
        description="By symbol."
    )
    numbers: dict[str, Annotated[dict[str, Any], AsKept(ComparedColumnsOut)]] = Field(
        description="Squarenesses, locations, by symbol."
    )
    kinds: dict[Kind, Annotated[dict[str, Any], AsKept(ComparedKindOut)] | None] = (
        Field(description="Null where both have no error motion of it.")
    )
    volumetric: Annotated[dict[str, Any], AsKept(ComparedVolumeOut)] | None
    not_compared: dict[str, str] = Field(description="The reason, by symbol.")
    links: ComparisonLinks
