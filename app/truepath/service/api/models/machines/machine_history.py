"""Calibration history of a machine, and comparison of machines."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.base import JOB_ID, OTHER_ID


class CalibrationOut(BaseModel):
    """One calibration of a machine."""

    job_id: str = Field(examples=[JOB_ID])
    run_ids: list[str]
    measured: str = Field(
        examples=["2026-05-04T09:30:00.000Z"],
        description="When its first Run began; when it was catalogued where no Run "
        "states it: such a one stands before all that are dated.",
    )
    machine_version: int | None = Field(
        description="Of the machine's configuration; null where nobody knows."
    )
    verdict: str | None = Field(examples=["usable"])


class HistoryEntry(BaseModel):
    """Which number a column is."""

    label: str = Field(
        examples=[""], description="`mean`, `p95` or `largest` of `volumetric`."
    )
    position: float | None = Field(description="Of the axis; null where there is none.")
    position_unit: str = Field(examples=["mm"])


class HistoryPoint(CalibrationOut):
    """A calibration with what it states of each entry."""

    value: list[float | None] = Field(description="One an entry; null if not stated.")
    uncertainty: list[float | None] = Field(description="Standard (k = 1).")
    expected_after: list[float | None] = Field(
        description="As full compensation is expected to leave it; told of "
        "`volumetric`, null of every other quantity."
    )
    expected_after_uncertainty: list[float | None] = Field(
        description="Standard (k = 1)."
    )


class HistoryOut(BaseModel):
    """A quantity over all calibrations of a machine, the oldest first."""

    schema_: Literal["machine-history/1"] = Field(alias="schema")
    machine: str = Field(examples=["mill-3"])
    quantity: str = Field(examples=["EXX"])
    unit: str = Field(examples=["um"])
    entries: list[HistoryEntry]
    calibrations: list[HistoryPoint]


class VolumetricChange(BaseModel):
    """One volumetric error less the other, without its best-fit rigid motion."""

    difference_um: float = Field(description="Root mean square over the travel.")
    by_chance_um: float = Field(
        description="What it stays below, with 97.5 %, where nothing has changed."
    )
    change_um: float = Field(description="What is left without the part of chance.")
    chance: float = Field(description="Of so large a difference without a change.")
    is_significant: bool


class ChangedEntryOut(BaseModel):
    """One table entry in both."""

    symbol: str = Field(examples=["EXX"])
    position: float | None
    position_unit: str
    unit: str = Field(examples=["um"])
    before: float
    after: float
    difference: float
    uncertainty: float = Field(description="Of the difference, standard (k = 1).")
    chance: float = Field(
        description="Of so large a difference anywhere in the tables without a change."
    )
    is_significant: bool


class ChangesOut(BaseModel):
    """What has changed between two calibrations, and how surely."""

    schema_: Literal["machine-changes/1"] = Field(alias="schema")
    machine: str = Field(examples=["mill-3"])
    since: CalibrationOut
    until: CalibrationOut
    has_changed: bool
    compensation_changed: bool = Field(
        False, description="The control compensated otherwise: that is no change."
    )
    chance: float = Field(
        examples=[0.05],
        description="Of saying so of a machine that has not changed, at most.",
    )
    factor: float = Field(
        description="Standard uncertainties that an entry has to differ by to count, "
        "since so many are looked at."
    )
    volumetric: VolumetricChange
    significant: list[ChangedEntryOut] = Field(
        description="Of each symbol that has changed the surest entry."
    )
    entries: list[ChangedEntryOut]
    not_compared: list[str] = Field(description="Symbols that only one of both states.")
    text: list[str] = Field(
        examples=[["EXX at 300 mm went from 4.1 to 9.8 µm, by +5.7 ± 1.2 µm (k = 2)."]]
    )


class ComparedMachine(CalibrationOut):
    """One machine by its newest usable calibration."""

    machine: str = Field(examples=["mill-3"])
    value: float
    uncertainty: float = Field(description="Standard (k = 1).")
    is_more_than: list[str] = Field(
        description="Machines whose number is less for sure."
    )
    tolerance_um: float | None


class MachineComparisonOut(BaseModel):
    """One quantity of several machines, the smallest first."""

    schema_: Literal["machine-comparison/1"] = Field(alias="schema")
    quantity: str = Field(examples=["volumetric"])
    label: str = Field(examples=["p95"])
    position: float | None
    unit: str = Field(examples=["um"])
    factor: float = Field(
        description="Combined standard uncertainties that two have to differ by."
    )
    machines: list[ComparedMachine]


class StandingOut(BaseModel):
    """How a machine stands by its newest usable calibration."""

    machine: str = Field(examples=["mill-3"])
    calibration: str | None = Field(examples=[OTHER_ID])
    is_alarm: bool = Field(description="Over its tolerance, or changed for sure.")
    tolerance: Literal["within", "over", "not-sure"] | None
    tolerance_text: str
    reference_job: str | None
    has_changed: bool | None
    change_text: str
