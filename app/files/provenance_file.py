"""What is reckoned with of the provenance of a result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, Strict

from truepath.app.files.file_model import FileModel, validate
from truepath.app.files.sample_sketch import SKETCH


class _RunBehind(FileModel):
    """A Run that a result was made from."""

    sketch: str = Field(default="", pattern=f"^{SKETCH}$")


class _Reckoned(FileModel):
    """What is reckoned with of the provenance, where it is stated."""

    measured_s: float | None = Field(default=None, ge=0.0)
    length_scale_ppm: float | None = Field(default=None, ge=0.0)
    runs: Annotated[tuple[_RunBehind, ...], Strict(False)] = ()
    temperature_degc: dict[str, Annotated[tuple[float, float], Strict(False)]] = Field(
        default_factory=dict, alias="temperature_degC"
    )


def require_reckoned(provenance: Mapping[str, Any], file: str) -> None:
    """Raise BundleError for what is no number where the provenance is reckoned with."""
    stated = {key: value for key, value in provenance.items() if value is not None}
    validate(_Reckoned, stated, file, key="provenance")
