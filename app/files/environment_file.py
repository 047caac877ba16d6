"""`environment.csv` of a bundle: temperatures on the tracker's clock."""

from __future__ import annotations

import io

import numpy as np

from app.errors import BundleError
from app.files.stream_file import read_clock
from app.files.tables import read_csv
from drivers.interfaces.records import TemperatureSamples

FILE = "environment.csv"
_DEGC = "_degC"


def decode_environment(data: bytes) -> TemperatureSamples:
    """Return the temperatures; columns that are none are left out."""
    table = read_csv(data, FILE)
    table.require("t_s")
    sensors = [key for key in table.names if key.endswith(_DEGC) and key != _DEGC]
    if not sensors:
        raise BundleError(
            "has no temperatures", file=FILE, remedy="columns are called <NAME>_degC"
        )
    if len(table) == 0:
        raise BundleError("has no rows", file=FILE, remedy="leave out the file")
    celsius = np.stack([table.numbers(key) for key in sensors], axis=1)
    names = tuple(key.removesuffix(_DEGC) for key in sensors)
    return TemperatureSamples(names, read_clock(table), celsius)


def encode_environment(temperature: TemperatureSamples) -> bytes:
    """Return the `environment.csv` of temperatures."""
    text = io.StringIO()
    names = [name + _DEGC for name in temperature.names]
    text.write(",".join(["t_s", *names]) + "\n")
    for time_s, row in zip(temperature.time_s, temperature.celsius, strict=True):
        text.write(",".join(repr(float(v)) for v in (time_s, *row)) + "\n")
    return text.getvalue().encode()
