"""Compensation files: what is asked for, what each format carries, what files leave."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from truepath.app.api.models.base import Links, RequestBody
from truepath.app.api.models.effects import EffectKeys
from truepath.app.api.models.tables import Vector3
from truepath.app.files.verdict import State as VerdictState


class SignOut(BaseModel):
    """How a value of the file moves the axis."""

    rule: str
    verified: bool = Field(
        description="From the maker's manual or source; else one deliberate value has "
        "to settle it at the machine before first use."
    )


class FormatOut(BaseModel):
    """A format of a controller."""

    name: str = Field(examples=["linuxcnc"])
    control: str = Field(examples=["LinuxCNC"])
    carries: str = Field(examples=["positioning of each axis, forward and reverse"])
    not_carried: str
    most_rows: int = Field(description="Of a table.")
    resolution_um: float
    sign: SignOut
    note: str = Field(description="What to do with the files at the control.")
    choices: dict[str, list[str]] = Field(
        description="What may be chosen, by name; the first word is usual.",
        examples=[{"control": ["840d-sl", "828d", "808d"]}],
    )
    by_axis: list[str] = Field(
        default_factory=list[str],
        description="Those of `choices` that may be stated axis by axis, as "
        "`X=1,Y=2`; the usual word for the others.",
        examples=[["measuring_system"]],
    )


class FormatList(BaseModel):
    """Every installed format, by name."""

    items: list[FormatOut]


FileText = Annotated[str, Field(max_length=1 << 20)]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,100}$")]


class CompensationRequest(RequestBody):
    """Which files to make of a result."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"format": "linuxcnc"}]}
    )

    format: str = Field(description="Name of an installed format.", max_length=50)
    spacing_mm: float = Field(
        10.0,
        ge=0.1,
        le=1000.0,
        allow_inf_nan=False,
        description="Of the rows, or the smallest that the controller has room for.",
    )
    unmeasured: Literal["hold", "fade", "refuse"] = Field(
        "hold", description="What tables have where an axis was not measured."
    )
    choices: dict[str, str] = Field(
        default_factory=dict,
        max_length=8,
        description="Of the format's choices, by name; the usual for the others.",
    )
    accept_verdict: bool = Field(
        False, description="Make files of a result that is not to be used."
    )
    active_files: dict[FileName, FileText] = Field(
        default_factory=dict,
        max_length=32,
        json_schema_extra={"additionalProperties": False},
        description="Text by name of the tables that the control had meanwhile, where "
        "the service has not loaded them itself.",
    )
    difference: bool = Field(
        False, description="Files of what the active tables lacked, not of both."
    )


class BasisOut(BaseModel):
    """What the files hold: the whole correction, or what active tables lacked."""

    holds: Literal["as-found", "as-measured", "combined", "difference"]
    control_compensation: Literal["on", "off"] | None = Field(
        description="While it was measured; null where nothing states it."
    )
    text: str


class MapErrorOut(BaseModel):
    """Volumetric error of the machine as it was found, µm."""

    mean: float
    largest: float


class LeftErrorOut(MapErrorOut):
    """Volumetric error that the files leave, of errors that the measurement allows."""

    mean_uncertainty: float = Field(description="Standard uncertainty of the mean.")


class VolumetricErrorOut(BaseModel):
    """Before and with the files, as their controller reads them."""

    before: MapErrorOut
    after: LeftErrorOut
    after_where_measured: LeftErrorOut | None = Field(
        description="Where every axis was measured; null if there is no such place."
    )
    on: str = Field(description="Where it was computed, in words.")


class LeftByReason(BaseModel):
    """What is left by its reasons, µm: root mean squares over the travel."""

    map: float = Field(description="Of the errors as they were found.")
    not_carried: float
    between_rows: float
    rounding: float
    unmeasured_range: float
    not_known_by_the_measurement: float


class HoldsForTargetOut(BaseModel):
    """The target that the files hold for."""

    target: str = Field(description="Its name; empty where there is one only.")
    offset_mm: Vector3
    confounded: list[str] = Field(description="Symbols that it cannot part.")


class TableFactsOut(BaseModel):
    """The table of an axis."""

    points: int
    spacing_mm: float
    from_mm: float
    to_mm: float
    measured_from_mm: float
    measured_to_mm: float
    zero: str


class OverAxesOut(BaseModel):
    """Mean length of the error where all axes move, rotary ones too, µm."""

    before: float
    before_expanded_uncertainty: float | None = None
    after: float = Field(description="That the files leave of the map.")
    after_expected: float | None = Field(
        None, description="That they leave of errors that the measurement allows."
    )
    after_expanded_uncertainty: float | None = Field(
        None, description="Of `after_expected`."
    )
    coverage_factor: float | None = Field(
        None,
        description="Of expanded uncertainties; null of files without them.",
    )
    on: str


class RotaryTableOut(BaseModel):
    """The table of a rotary axis."""

    points: int
    spacing_deg: float
    from_deg: float
    to_deg: float
    repeats_each_turn: bool


class BeforeAfterOut(BaseModel):
    """A root mean square before, and with the files."""

    before: float
    after: float


class RotaryChangeOut(BeforeAfterOut):
    """A root mean square of a rotary axis, with what the measurement allows."""

    after_expected: float | None = Field(
        None, description="That the files leave of errors that the measurement allows."
    )
    after_expanded_uncertainty: float | None = Field(
        None, description="Of `after_expected`, k = 2."
    )


class RotaryLeftOut(BaseModel):
    """What files leave of a rotary axis, root mean squares over the travel."""

    table: RotaryTableOut | None = Field(description="Null where the files have none.")
    positioning_urad: RotaryChangeOut | None = None
    at_tool_um: RotaryChangeOut | None = Field(
        None, description="What that positioning does to the tool."
    )
    location_at_tool_um: RotaryChangeOut | None = Field(
        None, description="What the place of the axis does to the tool."
    )
    lost_motion: str | None = Field(
        None,
        description="Whether the result has it, and the files, in words.",
        examples=["not in the result"],
    )
    lost_motion_urad: RotaryChangeOut | None = Field(
        None,
        description="By how much both directions differ; null without a result of it.",
    )
    not_in_files: list[str] = Field(description="Symbols that no table can have.")


class EffectLeftOut(EffectKeys):
    """What remains of an effect of a model. Further keys are those of its family."""

    rms_um: BeforeAfterOut
    note: str


class LengthsOut(BaseModel):
    """At which temperature lengths of the files hold: no number is normalised."""

    measured_degC: tuple[float, float] | None = Field(  # noqa: N815
        description="Lowest and highest of the axis scales, else of all sensors; null "
        "where unknown."
    )
    reference_degC: float = Field(examples=[20.0])  # noqa: N815
    normalised: bool
    text: str
    warning: str | None = Field(
        description="Where the measurement was more than 1 K off, or nobody knows."
    )


class CompensationLinks(Links):
    """Where the files are."""

    self: Annotated[str, "/jobs/{job}/compensations/{id}"]
    archive: Annotated[str, "/jobs/{job}/compensations/{id}/archive"]
    job: Annotated[str, "/jobs/{job}"]


class CompensationOut(BaseModel):
    """Files of a format and what they leave: the account that stands beside them."""

    id: str = Field(examples=["linuxcnc-10-hold"])
    format: str = Field(examples=["linuxcnc"])
    control: str
    choices: dict[str, str] = Field(
        default_factory=dict, description="Of the format, as they were taken."
    )
    basis: BasisOut | None = Field(None, description="Null of earlier files.")
    files: list[str] = Field(examples=[["compensation-X.tbl", "compensation-Y.tbl"]])
    files_sha256: dict[str, str] = Field(
        default_factory=dict, description="SHA-256 by name."
    )
    machine: str
    verdict: VerdictState = Field(description="Of the result they were made of.")
    carries: str
    not_carried: str
    sign: SignOut
    holds_for: HoldsForTargetOut
    tables: dict[str, TableFactsOut] = Field(description="By axis.")
    over_all_axes_um: OverAxesOut | None = Field(
        None, description="Null for a machine of straight axes."
    )
    rotary: dict[str, RotaryLeftOut] = Field(
        default_factory=dict, description="By rotary axis."
    )
    unmeasured: list[str] = Field(description="Ranges without a measurement, in words.")
    unobservable: list[str] = Field(description="What the data cannot tell.")
    volumetric_error_um: VolumetricErrorOut
    left_um: LeftByReason
    effects: list[EffectLeftOut] = Field(
        description="What remains of each effect of a model."
    )
    note: str
    stamp: list[str] = Field(
        default_factory=list,
        description="Where the files come from, what they are of, the range and the "
        "temperature they hold at: the lines of their comments, where their control "
        "reads any, and here for all.",
    )
    lengths: LengthsOut | None = Field(
        None, description="At which temperature lengths hold."
    )
    links: CompensationLinks


class CompensationList(BaseModel):
    """All files that were made of a result."""

    items: list[CompensationOut]
