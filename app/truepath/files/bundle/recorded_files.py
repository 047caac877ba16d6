"""Recorded data in a bundle: tracker stream, temperatures, direct measurements.

A stream has no counter in a bundle. It is rebuilt from the clock: a pause of k sample
intervals counts as k - 1 lost samples.
"""

from __future__ import annotations

import io
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.bundle.run import DirectMeasurement, PointRows, RunEvent
from truepath.files.bundle.sensor_gate import find_pressures, gate_columns
from truepath.files.environment.environment import (
    DEGC,
    HUMIDITY,
    PRESSURE,
    fill_columns,
    name_columns,
    split_columns,
)
from truepath.files.tables import Table, encode_csv, read_csv, read_parquet
from truepath_drivers.interfaces.records import (
    LOST,
    AirSamples,
    TemperatureSamples,
    TrackerSamples,
    is_seen,
)

_POSITION = ("x_mm", "y_mm", "z_mm")
_COVARIANCE = {  # of one shot about the mean
    "cov_xx_um2": (0, 0),
    "cov_xy_um2": (0, 1),
    "cov_xz_um2": (0, 2),
    "cov_yy_um2": (1, 1),
    "cov_yz_um2": (1, 2),
    "cov_zz_um2": (2, 2),
}
_STREAM = frozenset(
    ("t_s", *_POSITION, "status", "quality", "point", "shots", *_COVARIANCE)
)
_SENSORS = {  # by the end of a column: what it is here, factor, and what is added first
    "_degC": (DEGC, 1.0, 0.0),
    "_degF": (DEGC, 1.0 / 1.8, -32.0),
    "pressure_hPa": (PRESSURE, 1.0, 0.0),
    "pressure_mmHg": (PRESSURE, 1.33322387415, 0.0),
    "pressure_inHg": (PRESSURE, 33.8638866667, 0.0),
    "pressure_kPa": (PRESSURE, 10.0, 0.0),
    "humidity_percent": (HUMIDITY, 1.0, 0.0),
}
MAX_STREAM_TEXT_BYTES = 1 << 30  # a stream as text, in one piece in memory
_UM2 = 1e6  # in a mm²
_SYMBOL = re.compile(r"^[A-Z][0-9A-Z][A-Z]$")
_COLUMNS = ("error", "position_mm", "direction", "value", "unit")


def decode_tracker(
    data: bytes, *, file: str = "tracker.parquet"
) -> tuple[TrackerSamples, PointRows | None]:
    """The samples, and the columns with `point`; None without it.

    A name that ends in `.csv` is read as CSV.
    """
    is_text = file.endswith(".csv")
    table = read_csv(data, file) if is_text else read_parquet(data, file, _STREAM)
    table.require("t_s", *_POSITION)
    if not len(table):
        remedy = "record the stream again"
        raise BundleError("holds no samples", file=file, remedy=remedy)
    status = _read_status(table)
    position_mm = _read_positions(table, status)
    status[(status == 0) & ~is_seen(position_mm)] = LOST
    repeats = _find_repeats(table.numbers("t_s"), position_mm)
    time_s = _read_clock(table, repeats)[~repeats]
    if (status != 0).all():
        raise BundleError(
            "holds no valid sample: no status is 0",
            file=file,
            column="status",
            remedy="check that the beam was locked",
        )
    points = _read_points(table, ~repeats) if "point" in table.names else None
    counter = _rebuild_counter(time_s) if points is None else np.arange(len(time_s))
    quality = None
    if "quality" in table.names:
        quality = table.numbers("quality", nan=True)[~repeats].astype(np.float32)
    samples = TrackerSamples(
        counter, time_s, position_mm[~repeats], status[~repeats], quality
    )
    return samples, points


def encode_stream(samples: TrackerSamples, points: PointRows | None = None) -> bytes:
    """Bytes of `tracker.parquet`, with checksums."""
    columns = dict(zip(_POSITION, samples.position_mm.T, strict=True))
    table = pa.table(
        {
            "t_s": samples.device_time_s,
            **{key: np.ascontiguousarray(value) for key, value in columns.items()},
            "status": samples.status,
            **({} if samples.quality is None else {"quality": samples.quality}),
            **({} if points is None else _name_point_columns(points)),
        }
    )
    sink = io.BytesIO()
    pq.write_table(table, sink, write_page_checksum=True)
    return sink.getvalue()


def decode_environment(
    data: bytes, altitude_m: float | None = None, *, file: str = "environment.csv"
) -> tuple[TemperatureSamples | None, AirSamples | None, tuple[RunEvent, ...]]:
    """Temperatures and air, and events for rejected readings.

    Units are taken from the names of columns; other columns are left out. Raises
    BundleError for a pressure that is impossible at the site.
    """
    table = read_csv(data, file)
    table.require("t_s")
    table.require_rows("leave out the file")
    columns: dict[str, NDArray[np.float64]] = {}
    low, high = find_pressures(altitude_m)
    for key in table.names:
        end = next((end for end in _SENSORS if key.endswith(end)), key)
        own, factor, offset = _SENSORS.get(end, ("", 1.0, 0.0))
        name = key.removesuffix(end) + own
        if name in ("", DEGC) or (own != DEGC and key != end):
            continue  # of no sensor that is known here
        if name in columns:
            remedy = "leave one of the columns out"
            raise BundleError(f"is {name} again", file=file, column=key, remedy=remedy)
        columns[name] = value = factor * (table.numbers(key) + offset)
        is_site = altitude_m is None or ((low <= value) & (value <= high)).any()
        if name == PRESSURE and not is_site:
            site = f"at {altitude_m:g} m has {low:.0f} to {high:.0f} hPa"
            remedy = (
                "name its unit in the column (pressure_mmHg), or correct altitude_m"
            )
            raise table.error(f"is {value[0]:.0f} hPa: a site {site}", 0, key, remedy)
    if not columns:
        raise BundleError(
            "has no temperatures", file=file, remedy="columns are called <NAME>_degC"
        )
    time_s = _read_clock(table)
    columns, told = gate_columns(time_s, columns, altitude_m)
    return *split_columns(time_s, columns), told


def encode_environment(
    temperature: TemperatureSamples | None, air: AirSamples | None
) -> bytes:
    """Bytes of `environment.csv`, every cell a number.

    Between its readings a sensor is interpolated linearly; one with a hole that is too
    long for this is left out, by `find_missing`.
    """
    columns = name_columns(temperature, air)
    if not columns:
        return b""
    time_s = np.unique(np.concatenate([times for times, _ in columns.values()]))
    filled = fill_columns(columns, time_s)
    return encode_csv({"t_s": time_s} | filled) if filled else b""


def decode_reference(
    data: bytes, *, file: str = "reference.csv"
) -> tuple[DirectMeasurement, ...]:
    """One measurement per error, direction and unit, in order of rows."""
    table = read_csv(data, file)
    table.require(*_COLUMNS)
    table.require_rows("leave out the file")
    position, value = table.numbers("position_mm"), table.numbers("value")
    words = (table.texts(name) for name in ("error", "direction", "unit"))
    rows: dict[tuple[str, str, str], list[int]] = {}
    for index, (error, direction, unit) in enumerate(zip(*words, strict=True)):
        _check_row(table, index, error, direction, unit)
        rows.setdefault((error, direction, unit), []).append(index)
    return tuple(
        DirectMeasurement(*key, position[at], value[at]) for key, at in rows.items()
    )


def encode_reference(reference: tuple[DirectMeasurement, ...]) -> bytes:
    """Bytes of `reference.csv`."""
    rows = [
        (one.error, repr(float(position)), one.direction, repr(float(value)), one.unit)
        for one in reference
        for position, value in zip(one.position_mm, one.value, strict=True)
    ]
    return encode_csv(dict(zip(_COLUMNS, zip(*rows, strict=True), strict=True)))


def _name_point_columns(points: PointRows) -> dict[str, NDArray[np.generic]]:
    covariance = {
        key: _UM2 * points.covariance_mm2[:, i, j]
        for key, (i, j) in _COVARIANCE.items()
    }
    return {"point": points.row + 1, "shots": points.count, **covariance}


def _read_points(table: Table, kept: NDArray[np.bool_]) -> PointRows:
    point = table.numbers("point")
    odd = (point != np.rint(point)) | (point < 1)
    table.reject(
        odd,
        "point",
        lambda k: f"is {point[k]:g}, no row of points.csv",
        "count the rows of points.csv from 1",
    )
    shots = np.ones(len(table))
    if "shots" in table.names:
        shots = table.numbers("shots")
        odd = (shots != np.rint(shots)) | (shots < 1)
        table.reject(odd, "shots", lambda k: f"is {shots[k]:g}, no number of shots")
    covariance_mm2 = np.zeros((len(table), 3, 3))
    for key, (i, j) in _COVARIANCE.items():
        if key in table.names:
            covariance_mm2[:, [i, j], [j, i]] = table.numbers(key)[:, None] / _UM2
    return PointRows(
        point[kept].astype(np.int64) - 1,
        shots[kept].astype(np.int64),
        covariance_mm2[kept],
    )


def _read_clock(
    table: Table, repeats: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    time_s = table.numbers("t_s")
    back = np.diff(time_s) <= 0
    if repeats is not None:
        back &= ~repeats[1:]
    table.reject(
        np.append(False, back),
        "t_s",
        lambda k: f"does not increase: {time_s[k]:.6f} after {time_s[k - 1]:.6f}",
        "rows stand in the order of time, each time once",
    )
    return time_s


def _rebuild_counter(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    step_s = np.diff(time_s)
    if not step_s.size:
        return np.zeros(1, np.int64)
    steps = np.maximum(np.rint(step_s / np.median(step_s)), 1.0)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _find_repeats(
    time_s: NDArray[np.float64], position_mm: NDArray[np.float64]
) -> NDArray[np.bool_]:
    repeats = np.zeros(len(time_s), bool)
    same = np.diff(time_s) == 0
    repeats[1:] = same & (np.diff(position_mm, axis=0) == 0).all(axis=1)
    return repeats


def _read_positions(table: Table, status: NDArray[np.int64]) -> NDArray[np.float64]:
    position_mm = np.empty((len(table), 3))
    for column, key in enumerate(_POSITION):
        value = table.numbers(key, nan=True, infinite=True)
        position_mm[:, column] = np.where(np.isinf(value), np.nan, value)
        bad = table.find_empty(key) & (status == 0)
        remedy = "a sample without a position needs a status other than 0"
        table.reject(bad, key, lambda _: "is empty or NaN", remedy)
    return position_mm


def _read_status(table: Table) -> NDArray[np.int64]:
    if "status" not in table.names:
        return np.zeros(len(table), np.int64)
    value = table.numbers("status")
    odd = (value != np.rint(value)) | (np.abs(value) > 2**53)
    table.reject(odd, "status", lambda k: f"is {value[k]:g}, no whole number")
    return value.astype(np.int64)


def _check_row(table: Table, index: int, error: str, direction: str, unit: str) -> None:
    if not _SYMBOL.match(error):
        raise table.error(
            f"is {error!r}", index, "error", "write a symbol of ISO 230-1, such as EXX"
        )
    if direction not in ("+", "-"):
        raise table.error(f"is {direction!r}", index, "direction", "write + or -")
    if unit not in ("um", "urad"):
        raise table.error(f"is {unit!r}", index, "unit", "write um or urad")
