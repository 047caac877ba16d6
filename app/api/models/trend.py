"""A machine over time, as `trend.json` states it: uncertainties are standard ones."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from truepath.app.files.verdict import State as VerdictState

TableColumn = list[float]


class QuantilesOut(BaseModel):
    """Median of a number with its 95 % interval."""

    median: float
    low: float
    high: float


class ErrorTableOut(BaseModel):
    """One error motion: positions in mm or deg, values in µm or µrad."""

    position_mm: TableColumn | None = None
    position_deg: TableColumn | None = None
    value_um: TableColumn | None = None
    value_urad: TableColumn | None = None
    uncertainty_um: TableColumn | None = None
    uncertainty_urad: TableColumn | None = None
    extrapolated: list[bool]


class SquarenessOut(BaseModel):
    """One squareness in µrad."""

    value: float
    uncertainty: float


class TablesAtOut(BaseModel):
    """The machine at one time."""

    time_h: float = Field(description="Since the middle of the first Run.")
    change_um: QuantilesOut = Field(
        description="How far it is off the tables of the last Run, root mean square "
        "over the travel."
    )
    error_tables: dict[str, ErrorTableOut]
    squareness_urad: dict[str, SquarenessOut]
    axis_location: dict[str, dict[str, float]] | None = Field(
        None, description="Of machines with rotary axes."
    )


class RunAtOut(TablesAtOut):
    """The machine at one of the Runs, from all of them."""

    name: str
    sha256: str
    temperature_degC: dict[str, tuple[float, float]]  # noqa: N815


class OutlookOut(BaseModel):
    """When to calibrate again; `time_h` with the median and 95 % of courses below."""

    state: Literal[
        "due", "not-within-horizon", "cannot-be-said", "already", "not-known"
    ]
    grade: Literal["certain", "likely", "possible"] | None = Field(
        description="Of due and not-within-horizon: by the chance at the horizon."
    )
    sentence: str
    limit_um: float | None
    chance: float = Field(description="Of exceeding the limit, at which it is due.")
    exceeded: float | None = Field(
        description="The chance that the limit is exceeded by the horizon."
    )
    due_h: float | None
    expected_h: float | None = Field(description="Where the chance is one half.")
    time_h: TableColumn
    median_um: TableColumn
    high_um: TableColumn


class TrendVerdict(BaseModel):
    """What the Runs say of themselves; reasons name their Run."""

    state: VerdictState
    reasons: list[str]
    details: list[dict[str, Any]]


class TrendOut(BaseModel):
    """Content of `trend.json`, schema `trend/1`."""

    schema_: Literal["trend/1"] = Field(alias="schema")
    machine: dict[str, Any]
    verdict: TrendVerdict
    runs: list[RunAtOut]
    later: list[TablesAtOut]
    states: dict[str, QuantilesOut]
    sensors: list[str]
    outlook: OutlookOut
    not_told: list[str]
