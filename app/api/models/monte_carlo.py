"""Stated uncertainties held against Monte Carlo trials (JCGM 101)."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel

from truepath.app.api.models.tables import TableColumn


class TrialTableOut(BaseModel):
    """Numbers by the linear law beside the trials: one a position, µm or µrad.

    `tolerance` is δ of clause 8, by which `agrees` is decided.
    """

    position_mm: TableColumn | None = None
    position_deg: TableColumn | None = None
    value_um: TableColumn | None = None
    linear_uncertainty_um: TableColumn | None = None
    mean_um: TableColumn | None = None
    uncertainty_um: TableColumn | None = None
    interval_95_low_um: TableColumn | None = None
    interval_95_high_um: TableColumn | None = None
    tolerance_um: TableColumn | None = None
    value_urad: TableColumn | None = None
    linear_uncertainty_urad: TableColumn | None = None
    mean_urad: TableColumn | None = None
    uncertainty_urad: TableColumn | None = None
    interval_95_low_urad: TableColumn | None = None
    interval_95_high_urad: TableColumn | None = None
    tolerance_urad: TableColumn | None = None
    agrees: list[bool]


class TrialNumberOut(BaseModel):
    """One number by the linear law beside the trials, µm or µrad."""

    value_um: float | None = None
    linear_uncertainty_um: float | None = None
    mean_um: float | None = None
    uncertainty_um: float | None = None
    interval_95_low_um: float | None = None
    interval_95_high_um: float | None = None
    tolerance_um: float | None = None
    value_urad: float | None = None
    linear_uncertainty_urad: float | None = None
    mean_urad: float | None = None
    uncertainty_urad: float | None = None
    interval_95_low_urad: float | None = None
    interval_95_high_urad: float | None = None
    tolerance_urad: float | None = None
    agrees: bool


class TrialMapOut(BaseModel):
    """The volumetric error at a few positions: x, y and z of one after another."""

    of: str
    position: list[list[float]]
    value_um: TableColumn
    linear_uncertainty_um: TableColumn
    mean_um: TableColumn
    uncertainty_um: TableColumn
    interval_95_low_um: TableColumn
    interval_95_high_um: TableColumn
    tolerance_um: TableColumn
    agrees: list[bool]


class TrialsOut(BaseModel):
    """The uncertainties held against trials."""

    method: str
    seed: int
    trials: int
    block: int
    significant_digits: int
    coverage: float
    interval: Literal["symmetric", "shortest"]
    settled: bool
    agrees: bool
    numbers: int
    agreeing: int
    largest_disagreement: float
    error_tables: dict[str, TrialTableOut]
    squareness_urad: dict[str, TrialNumberOut]
    axis_location: dict[str, TrialNumberOut]
    volumetric_error: TrialMapOut
