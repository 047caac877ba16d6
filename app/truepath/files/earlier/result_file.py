"""Result files (schema `result/1`) and model files (`extended-model/1`), read.

Both contain a model of the machine, so that whatever predicts, exports or compares from
a result does so from a model as well.

Verifications and accounts of compensation files are checked: a text in place of a
number in them, or a missing key, would appear on a certificate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import AfterValidator, BeforeValidator, Field, Strict, model_validator

from truepath.documents.file_model import (
    FileModel,
    Text,
    parse_json,
    reject,
    require_finite,
    validate,
)
from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError
from truepath.files.bundle.machine_file import MachineFile
from truepath.files.bundle.run import SKETCH
from truepath.files.earlier.model_file import model_from_json
from truepath.files.earlier.verdict import State, Verdict, verdict_from_json
from truepath.files.units import PER_PPM
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    LINEAR,
    TURNS,
    find_unit,
    is_positioning,
    list_error_motions,
)
from truepath.kinematics.model import EstimatedModel

RESULT_SCHEMA, MODEL_SCHEMA = "result/1", "extended-model/1"
LARGEST_BYTES = 1 << 30  # of a result file or of points


@dataclass(frozen=True, slots=True)
class HalfDifference:
    """Half the difference of both directions of an error motion, over its axis.

    position : mm or deg; value : µm or µrad
    sigma : standard uncertainty of the values; None where it is not stated
    """

    position: Float64[np.ndarray, " m"]
    value: Float64[np.ndarray, " m"]
    sigma: Float64[np.ndarray, " m"] | None = None


@dataclass(frozen=True, slots=True)
class CalibrationResult(EstimatedModel):
    """Content of a result or model file.

    unobservable : sentences; provenance : as in the file
    measured : by axis, the range beyond which tables are extrapolated, if it is known
    halves : half differences by symbol, positioning (EXX, ECC) before others; none
        where direction has no effect
    noise_freedom : independent values in the measurement's estimate of its slow noise;
        None where the file does not state it
    version : of the model; that of a result, which has no parent, is 1
    verdict : usable where the file has none
    states_direction : whether the file states the effect of the direction of travel, be
        it none
    ended : names of effects that a model's Runs showed and that ended with them
    """

    mode: str = "otf"
    unobservable: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])
    measured: dict[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    halves: dict[str, HalfDifference] = field(default_factory=dict[str, HalfDifference])
    noise_freedom: float | None = None
    version: int = 1
    verdict: Verdict = field(default_factory=Verdict)
    states_direction: bool = True
    ended: tuple[str, ...] = ()

    @property
    def machine(self) -> Machine:
        """With the measured targets."""
        return self.model.machine

    @property
    def length_scale_ppm(self) -> float:
        """Standard uncertainty that all its lengths have in common; 0 if not stated."""
        stated = self.provenance.get("length_scale_ppm")
        return float(stated) if isinstance(stated, int | float) else 0.0

    @property
    def known_lengths(self) -> KnownLengthsFile | None:
        """That scale by known lengths; None where there were none."""
        stated = self.provenance.get("known_lengths")
        return None if stated is None else KnownLengthsFile.model_validate(stated)


class _RunBehind(FileModel):
    sketch: str = Field(default="", pattern=f"^{SKETCH}$")


class KnownLengthsFile(FileModel):
    """By how much the tracker's ranges were too long, by known lengths."""

    count: int = Field(ge=1)
    off_ppm: float
    uncertainty_ppm: float = Field(ge=0.0)


class _Reckoned(FileModel):
    measured_s: float | None = Field(default=None, ge=0.0)
    length_scale_ppm: float | None = Field(default=None, ge=0.0)
    length_scale_in_tables: bool = False
    known_lengths: KnownLengthsFile | None = None
    runs: Annotated[tuple[_RunBehind, ...], Strict(False)] = ()
    temperature_degc: dict[str, Annotated[tuple[float, float], Strict(False)]] = Field(
        default_factory=dict, alias="temperature_degC"
    )


class _Observability(FileModel):
    unobservable: list[Text]


class _LinearRange(FileModel):
    from_mm: float
    to_mm: float

    @model_validator(mode="after")
    def _require_order(self) -> _LinearRange:
        if self.to_mm < self.from_mm:
            problem = f"is {self.to_mm:g}, below from_mm {self.from_mm:g}"
            raise reject(problem, "write the lower end as from_mm", "to_mm")
        return self


class _RotaryRange(FileModel):
    from_deg: float
    to_deg: float


class _Ranges(FileModel):
    X: _LinearRange | None = None
    Y: _LinearRange | None = None
    Z: _LinearRange | None = None
    A: _RotaryRange | None = None
    B: _RotaryRange | None = None
    C: _RotaryRange | None = None


class _HalfDifference(FileModel):
    position_mm: list[float] = Field(default_factory=list[float])
    position_deg: list[float] = Field(default_factory=list[float])
    value_um: list[float] = Field(default_factory=list[float])
    value_urad: list[float] = Field(default_factory=list[float])
    uncertainty_um: list[float] = Field(default_factory=list[float])
    uncertainty_urad: list[float] = Field(default_factory=list[float])

    def read(self, symbol: str) -> HalfDifference:
        unit, along = find_unit(symbol), "deg" if symbol[2] in TURNS else "mm"
        columns = self.model_dump()
        at, value, sigma = (
            np.array(columns[key], float)
            for key in (f"position_{along}", f"value_{unit}", f"uncertainty_{unit}")
        )
        if len(at) == 0 or len(at) != len(value):
            problem = f"are {len(value)} for {len(at)} in position_{along}"
            place = "half_difference", symbol, f"value_{unit}"
            raise reject(problem, "write one a position", *place)
        if len(sigma) not in (0, len(at)):
            problem = f"are {len(sigma)} for {len(at)} in position_{along}"
            place = "half_difference", symbol, f"uncertainty_{unit}"
            raise reject(problem, "write one a position, or none", *place)
        if np.any(np.diff(at) <= 0.0):
            place = "half_difference", symbol, f"position_{along}"
            raise reject("do not ascend", "sort the rows by position", *place)
        return HalfDifference(at, value, sigma if len(sigma) else None)


def _keep_error_motions(content: object) -> object:
    if not isinstance(content, Mapping):
        return content
    every = [s for axis in LINEAR + TURNS for s in list_error_motions(axis)]
    return {symbol: content[symbol] for symbol in every if symbol in content}


class _Direction(FileModel):
    half_difference: Annotated[
        dict[str, _HalfDifference], BeforeValidator(_keep_error_motions)
    ]

    @model_validator(mode="after")
    def _require_columns(self) -> _Direction:
        self.read()
        return self

    def read(self) -> dict[str, HalfDifference]:
        every = {s: half.read(s) for s, half in self.half_difference.items()}
        own = {s: half for s, half in every.items() if is_positioning(s)}
        return own | every


class _Noise(FileModel):
    slow_time_s: float = Field(gt=0.0)


class _Verdict(FileModel):
    """Details of another version are replaced by its sentences."""

    state: State
    reasons: list[Text]
    details: Any = ()


class _MachineOfResult(FileModel):
    machine: MachineFile


class _Document(_MachineOfResult):
    mode: Literal["otf", "standstill"]
    direction: _Direction | None = None
    measured_range: _Ranges = _Ranges()
    observability: _Observability
    noise: _Noise | None = None
    provenance: Annotated[dict[str, Any], AfterValidator(require_finite)]
    model: Any
    verdict: _Verdict | None = None

    @model_validator(mode="before")
    @classmethod
    def _require_schema_and_model(cls, content: object) -> object:
        if not isinstance(content, Mapping):
            return content
        schema = content.get("schema")
        if schema is None:
            raise reject("is missing", "add it", "schema")
        if schema not in (RESULT_SCHEMA, MODEL_SCHEMA):
            remedy = f"give a file of {RESULT_SCHEMA} or {MODEL_SCHEMA}"
            raise reject("is not that of a result or model", remedy, "schema")
        if content.get("model") is None:
            problem = "is missing, without which nothing can be predicted"
            raise reject(problem, "analyse the bundle again", "model")
        return content

    def ranges(self) -> dict[str, tuple[float, float]]:
        stated = self.measured_range.model_dump(exclude_none=True)
        return {name: tuple(ends.values()) for name, ends in stated.items()}

    def read_verdict(self) -> Verdict:
        if self.verdict is None:
            return Verdict()
        return verdict_from_json(self.verdict.model_dump())

    def count_noise_freedom(self) -> float | None:
        """Three components once per two correlation times of the slow noise."""
        measured_s = self.provenance.get("measured_s")
        if self.noise is None or not isinstance(measured_s, int | float):
            return None
        return max(3.0 * measured_s / (2.0 * self.noise.slow_time_s), 1.0)


class ResultDocument(_Document):
    """A result file, with the keys that its schema requires."""

    error_tables: Any
    squareness_urad: Any
    alignment: Any
    residuals: Any


class _FoundEffect(FileModel):
    name: Text
    part_of: Text = "machine"


class ModelDocument(_Document):
    """A model file."""

    version: Annotated[float, Field(ge=1.0)]
    effects: list[_FoundEffect] = Field(default_factory=list[_FoundEffect])

    @model_validator(mode="after")
    def _require_whole_version(self) -> ModelDocument:
        if self.version != int(self.version):
            raise reject(f"is {self.version:g}", "write a whole number", "version")
        return self


def read_result(file: str | Path) -> CalibrationResult:
    """Raises BundleError."""
    return decode_result(read_whole(file, largest_bytes=LARGEST_BYTES), file=str(file))


def read_result_machine(file: str | Path) -> Machine:
    """Only the machine of a result or model file. Raises BundleError."""
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    content = parse_json(data, str(file))
    return validate(_MachineOfResult, content, str(file)).machine.machine()


def decode_result(data: bytes, *, file: str) -> CalibrationResult:
    """From bytes of a result or model file. Raises BundleError."""
    return result_from_json(parse_json(data, file), file=file)


def result_from_json(
    content: object, *, file: str = "result.json"
) -> CalibrationResult:
    """From the parsed JSON of a result file, or of a model file.

    Raises BundleError naming file and key if it is of another schema or incomplete.
    """
    extended = isinstance(content, Mapping) and content.get("schema") == MODEL_SCHEMA
    document = validate(ModelDocument if extended else ResultDocument, content, file)
    stated = {k: v for k, v in document.provenance.items() if v is not None}
    validate(_Reckoned, stated, file, key="provenance")
    machine = document.machine.machine()
    estimated = model_from_json(document.model, machine, file=file)
    ranges = document.ranges()
    _require_within_travel(ranges, machine, file)
    direction = document.direction or _Direction(half_difference={})
    version, ended = 1, list[str]()
    if isinstance(document, ModelDocument):
        version = int(document.version)
        ended = [e.name for e in document.effects if e.part_of == "measurement"]
    result = CalibrationResult(
        estimated.model,
        estimated.theta,
        estimated.covariance,
        document.mode,
        tuple(document.observability.unobservable),
        document.provenance,
        {a.name: ranges[a.name] for a in machine.axes if a.name in ranges},
        direction.read(),
        document.count_noise_freedom(),
        version,
        document.read_verdict(),
        document.direction is not None,
        tuple(dict.fromkeys(ended)),
    )
    if result.provenance.get("length_scale_in_tables"):
        return result
    return result.widen_by_scale(PER_PPM * result.length_scale_ppm)


def _require_within_travel(
    ranges: Mapping[str, tuple[float, float]], machine: Machine, file: str
) -> None:
    for axis in machine.linear_axes:
        low, high = ranges.get(axis.name, (axis.low, axis.high))
        if high < axis.low or low > axis.high:
            raise BundleError(
                f"measured_range.{axis.name} is {low:g} to {high:g} mm, beyond the "
                f"travel {axis.low:g} to {axis.high:g} mm",
                file=file,
                remedy="analyse the bundle again",
            )


class _Finite(FileModel):
    @model_validator(mode="before")
    @classmethod
    def _require_finite(cls, content: object) -> object:
        return require_finite(content)


class _Before(FileModel):
    mean: float = Field(ge=0.0)


class _After(_Before):
    mean_uncertainty: float = Field(ge=0.0)


class _Error(FileModel):
    before: _Before
    after: _After


class _Sign(FileModel):
    verified: bool


class _Account(_Finite):
    format: str
    control: str
    carries: str
    not_carried: str
    files: list[str]
    sign: _Sign
    volumetric_error_um: _Error


def require_account(content: object, file: str) -> None:
    """Raise BundleError where the record of compensation files is incomplete."""
    validate(_Account, content, file)


def require_finite_numbers(content: object, file: str) -> None:
    """Raise BundleError where a number of a file is not finite."""
    validate(_Finite, content, file)
