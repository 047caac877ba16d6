"""Result and model files, read: as they are, or as knowledge before a measurement."""

from __future__ import annotations

import hashlib
from pathlib import Path

from app.errors import BundleError
from app.measurement.json_fields import parse_json
from app.reporting.earlier_model import EarlierModel
from app.reporting.result_json import LoadedResult, read_result

_LARGEST = 1 << 30  # bytes of a result file or of points


def read_model(file: str | Path, source: str = "") -> EarlierModel:
    """Read a model or result file. Raises BundleError.

    source : what the model is called in what comes of it; its file if left out
    """
    data = read_file(file)
    loaded = read_result(parse_json(data, str(file)), file=str(file))
    return EarlierModel(loaded, source or str(file), hashlib.sha256(data).hexdigest())


def load_result(file: str | Path) -> LoadedResult:
    """Read a result or model file. Raises BundleError."""
    return read_result(parse_json(read_file(file), str(file)), file=str(file))


def read_file(file: str | Path) -> bytes:
    """Return the bytes of a file of bounded size. Raises BundleError."""
    place = Path(file)
    try:
        if place.stat().st_size > _LARGEST:
            raise BundleError(f"is larger than {_LARGEST >> 20} MiB", file=str(file))
        return place.read_bytes()
    except OSError as error:
        raise BundleError(
            f"cannot be read ({error.strerror})",
            file=str(file),
            remedy="check the path",
        ) from error
