"""Recorded data in a bundle: stream, environment, direct measurements, known lengths.

A stream has no counter in a bundle. It is rebuilt from the clock: a pause of k sample
intervals counts as k - 1 lost samples.

Known lengths are a scale bar, the travel of an interferometer, the distance by a second
tracker: x1_mm to z2_mm are the ends in the tracker's frame, length_mm and u_mm the
known value, with its standard uncertainty. measured_mm is the tracker's own where it is
not the distance of the ends. With temperature_degC and expansion_um_per_m_K length_mm
is that at 20 °C, else that as it was measured.
"""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.bundle.run import (
    DirectMeasurement,
    KnownLength,
    PointRows,
    Run,
    RunEvent,
)
from truepath.files.bundle.sensor_gate import find_pressures, gate_columns
from truepath.files.environment import (
    DEGC,
    HUMIDITY,
    MEASURED,
    PRESSURE,
    fill_columns,
    find_factor,
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
_REFERENCE = ("error", "position_mm", "direction", "value", "unit")
KNOWN_LENGTHS = "known_lengths.csv"
_ENDS = tuple(f"{axis}{end}_mm" for end in (1, 2) for axis in "xyz")
_LENGTHS = (*_ENDS, "length_mm", "u_mm", "measured_mm")
_THERMAL = ("temperature_degC", "expansion_um_per_m_K")
_AT_DEGC = 20.0
_SHORTEST_MM = 100.0
_MOST_LENGTHS = 1000
_WRONG = 1e-3  # of the length: a slip of unit, point or row, no scale


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
    data: bytes, altitude_m: float | None
) -> tuple[TemperatureSamples | None, AirSamples | None, tuple[RunEvent, ...]]:
    """Temperatures and air, and events for rejected readings.

    Units are taken from the names of columns; other columns are left out. Raises
    BundleError for a pressure that is impossible at the site.
    """
    file = "environment.csv"
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
    table.require(*_REFERENCE)
    table.require_rows("leave out the file")
    position, value = table.numbers("position_mm"), table.numbers("value")
    words = (table.texts(name) for name in ("error", "direction", "unit"))
    rows: dict[tuple[str, str, str], list[int]] = {}
    for index, (error, direction, unit) in enumerate(zip(*words, strict=True)):
        if not _SYMBOL.match(error):
            remedy = "write a symbol of ISO 230-1, such as EXX"
            raise table.error(f"is {error!r}", index, "error", remedy)
        if direction not in ("+", "-"):
            problem = f"is {direction!r}"
            raise table.error(problem, index, "direction", "write + or -")
        if unit not in ("um", "urad"):
            raise table.error(f"is {unit!r}", index, "unit", "write um or urad")
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
    return encode_csv(dict(zip(_REFERENCE, zip(*rows, strict=True), strict=True)))


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


def decode_known_lengths(
    data: bytes, *, file: str = KNOWN_LENGTHS
) -> tuple[KnownLength, ...]:
    """Lengths at the temperature of measurement. Raises BundleError."""
    table = read_csv(data, file)
    table.require_rows("leave out the file")
    if len(table) > _MOST_LENGTHS:
        raise BundleError(
            f"has {len(table)} rows, more than {_MOST_LENGTHS}",
            file=file,
            remedy="give fewer: the same bar tells hardly more each time",
        )
    ends_mm = np.stack([table.numbers(name) for name in _ENDS], axis=1)
    ends_mm = ends_mm.reshape(-1, 2, 3)
    apart_mm = np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1)
    length_mm, sigma_mm = table.numbers("length_mm"), table.numbers("u_mm")
    table.reject(
        length_mm < (1.0 - _WRONG) * _SHORTEST_MM,  # a warm bar was longer
        "length_mm",
        lambda k: f"is {length_mm[k]:g}, shorter than {_SHORTEST_MM:g} mm",
        "state it in mm, or leave the row out: it says nothing of a scale",
    )
    table.reject(
        sigma_mm <= 0.0,
        "u_mm",
        lambda k: f"is {sigma_mm[k]:g}",
        "state the standard uncertainty of the length, half of one that is for k = 2",
    )
    near_mm = np.linalg.norm(ends_mm, axis=2).min(axis=1)
    table.reject(
        near_mm < _SHORTEST_MM,
        "x1_mm",
        lambda k: f"puts an end {near_mm[k]:g} mm from the tracker",
        "state both ends in the tracker's frame, as it shows them",
    )
    length_mm, sigma_mm = _warm(table, length_mm, sigma_mm)
    measured_mm, column = apart_mm, "x1_mm"
    if "measured_mm" in table.names:
        measured_mm, column = table.numbers("measured_mm"), "measured_mm"
        table.reject(
            np.abs(measured_mm - apart_mm) > _WRONG * apart_mm,
            column,
            lambda k: f"is {measured_mm[k]:g}, the ends are {apart_mm[k]:.3f} mm apart",
            "state both as the tracker has measured them",
        )
    table.reject(
        np.abs(measured_mm - length_mm) > _WRONG * length_mm,
        column,
        lambda k: f"makes {measured_mm[k]:.3f} mm of a length of {length_mm[k]:.3f} mm",
        "look at the row's ends, its length and its temperature",
    )
    rows = (
        ends_mm.tolist(),
        *(values.tolist() for values in (measured_mm, length_mm, sigma_mm)),
    )
    return tuple(
        KnownLength((tuple(first), tuple(second)), *stated)
        for (first, second), *stated in zip(*rows, strict=True)
    )


def encode_known_lengths(lengths: tuple[KnownLength, ...]) -> bytes:
    """Bytes of `known_lengths.csv`, at the temperature of measurement."""
    rows = [
        (*np.ravel(one.ends_mm), one.length_mm, one.sigma_mm, one.measured_mm)
        for one in lengths
    ]
    return encode_csv(dict(zip(_LENGTHS, np.array(rows).T, strict=True)))


def add_known_lengths(run: Run, lengths: tuple[KnownLength, ...]) -> Run:
    """Replace the known lengths of a Run; given as the tracker showed them."""
    factor = find_factor(run.refraction)
    return replace(run, known_lengths=tuple(one.scale(factor) for one in lengths))


def _warm(
    table: Table, length_mm: np.ndarray, sigma_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths at their temperatures, whose uncertainty is that of the air's."""
    if not set(_THERMAL) & set(table.names):
        return length_mm, sigma_mm
    degc, per_k = table.numbers(_THERMAL[0]), 1e-6 * table.numbers(_THERMAL[1])
    table.reject(
        np.abs(degc - _AT_DEGC) > 40.0,
        _THERMAL[0],
        lambda k: f"is {degc[k]:g}",
        "state the temperature of the length in °C",
    )
    table.reject(
        np.abs(per_k) > 1e-4,
        _THERMAL[1],
        lambda k: f"is {1e6 * per_k[k]:g}",
        "steel has 11.5",
    )
    by_warmth_mm = length_mm * per_k * MEASURED["air_degC"]
    grown_mm = length_mm * (1.0 + per_k * (degc - _AT_DEGC))
    return grown_mm, np.hypot(sigma_mm, by_warmth_mm)
