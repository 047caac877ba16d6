"""Keys of a result's provenance that enter calculations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, Strict

from truepath.documents.file_model import FileModel, as_object, validate
from truepath.files.bundle.sample_sketch import SKETCH

CONTROL, ON, OFF, MIXED = "control_compensation", "on", "off", "mixed"


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


def require_reckoned(provenance: Mapping[str, Any], file: str) -> None:
    """Raise BundleError for wrong values of the keys that enter calculations."""
    stated = {key: value for key, value in provenance.items() if value is not None}
    validate(_Reckoned, stated, file, key="provenance")


def read_control_state(provenance: Mapping[str, Any]) -> str | None:
    """`on`, `off` or `mixed`: whether the control compensated; None if unknown.

    provenance : of a result
    """
    source = as_object(provenance.get("source"))
    return provenance.get(CONTROL) or source.get(CONTROL)
