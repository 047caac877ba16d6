"""A result against a direct measurement, as `comparison.json` states it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from truepath.app.api.models.base import Links


class ComparisonLinks(Links):
    """Where a comparison is."""

    self: Annotated[str, "/jobs/{job}/comparisons/{id}"]
    report_html: Annotated[str, "/jobs/{job}/comparisons/{id}/report.html"]


class ComparisonOut(BaseModel):
    """A result less a direct measurement; uncertainties are standard ones (k = 1)."""

    id: str
    schema_: Literal["comparison/1"] = Field(alias="schema")
    machine: str
    result: str
    reference: str
    verdict: dict[str, Any] = Field(description="That of the result.")
    convention: str
    errors: dict[str, dict[str, Any]] = Field(
        description="By symbol: positions, result, reference, their difference and "
        "`en`, the difference over its expanded uncertainty."
    )
    numbers: dict[str, dict[str, Any]] = Field(description="Squarenesses, locations.")
    kinds: dict[str, dict[str, Any] | None]
    volumetric: dict[str, Any] | None
    not_compared: dict[str, str] = Field(description="The reason, by symbol.")
    links: ComparisonLinks
