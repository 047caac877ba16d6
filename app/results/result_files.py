"""Result and model files, read: as they are, or as knowledge before a measurement."""

from __future__ import annotations

import hashlib
from pathlib import Path

from app.files.json_fields import parse_json
from app.files.whole_files import read_whole
from app.results.earlier_model import EarlierModel
from app.results.result_json import LoadedResult, read_result

LARGEST_BYTES = 1 << 30  # of a result file or of points


def read_model(file: str | Path, source: str = "") -> EarlierModel:
    """Read a model or result file. Raises BundleError.

    source : what the model is called in what comes of it; its file if left out
    """
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    loaded = read_result(parse_json(data, str(file)), file=str(file))
    return EarlierModel(loaded, source or str(file), hashlib.sha256(data).hexdigest())


def load_result(file: str | Path) -> LoadedResult:
    """Read a result or model file. Raises BundleError."""
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    return read_result(parse_json(data, str(file)), file=str(file))
