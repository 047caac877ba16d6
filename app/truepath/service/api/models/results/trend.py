"""A machine over time, as in `trend.json`; standard uncertainties (k = 1)."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.machines.machine_file import MachineFileOut
from truepath.service.api.models.tables import TableColumn, TablesOut, VerdictOut


class QuantilesOut(BaseModel):
    """Median of a number with its 95 % interval."""

    median: float
    low: float
    high: float


class TablesAtOut(TablesOut):
    """The machine at one time."""

    time_h: float = Field(description="Since the middle of the first Run.")
    change_um: QuantilesOut = Field(
        description="How far it is off the tables of the last Run, root mean square "
        "over the travel."
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


class TrendOut(BaseModel):
    """Content of `trend.json`, schema `trend/1`."""

    schema_: Literal["trend/1"] = Field(alias="schema")
    machine: MachineFileOut
    verdict: VerdictOut
    runs: list[RunAtOut]
    later: list[TablesAtOut]
    states: dict[str, QuantilesOut]
    sensors: list[str]
    outlook: OutlookOut
    not_told: list[str]
