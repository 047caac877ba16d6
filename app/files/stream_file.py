"""`tracker.parquet` or `tracker.csv` of a bundle: the raw stream of the tracker.

A stream has no counter in a bundle. It is rebuilt from the clock: a pause of k sample
intervals counts as k - 1 lost samples.
"""

from __future__ import annotations

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from app.errors import BundleError
from app.files.tables import Table, read_csv, read_parquet
from drivers.interfaces.records import TrackerSamples

_POSITION = ("x_mm", "y_mm", "z_mm")


def decode_stream(data: bytes, *, file: str = "tracker.parquet") -> TrackerSamples:
    """Return the samples of a stream; a name that ends in `.csv` is read as CSV."""
    table = read_csv(data, file) if file.endswith(".csv") else read_parquet(data, file)
    table.require("t_s", *_POSITION)
    if len(table) == 0:
        raise BundleError(
            "holds no samples", file=file, remedy="record the stream again"
        )
    status = _read_status(table)
    position_mm = _read_positions(table, status)
    repeats = _find_repeats(table.numbers("t_s"), position_mm)
    time_s = read_clock(table, repeats)[~repeats]
    if (status != 0).all():
        raise BundleError(
            "holds no valid sample: no status is 0",
            file=file,
            column="status",
            remedy="check that the beam was locked",
        )
    return TrackerSamples(
        counter_of(time_s), time_s, position_mm[~repeats], status[~repeats]
    )


def encode_stream(samples: TrackerSamples) -> bytes:
    """Return the `tracker.parquet` of samples."""
    columns = dict(zip(_POSITION, samples.position_mm.T, strict=True))
    table = pa.table(
        {
            "t_s": samples.device_time_s,
            **{key: np.ascontiguousarray(value) for key, value in columns.items()},
            "status": samples.status,
        }
    )
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def read_clock(
    table: Table, repeats: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the column `t_s`, which must increase from row to row but at repeats."""
    time_s = table.numbers("t_s")
    back = np.diff(time_s) <= 0
    if repeats is not None:
        back &= ~repeats[1:]
    if back.any():
        index = int(np.argmax(back)) + 1
        raise table.error(
            f"does not increase: {time_s[index]:.6f} after {time_s[index - 1]:.6f}",
            index,
            "t_s",
            "rows stand in the order of time, each time once",
        )
    return time_s


def counter_of(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rebuild the counter of the device from its clock."""
    step_s = np.diff(time_s)
    if not step_s.size:
        return np.zeros(1, np.int64)
    steps = np.maximum(np.rint(step_s / np.median(step_s)), 1.0)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _find_repeats(
    time_s: NDArray[np.float64], position_mm: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Tell which rows are the row before once more: a frame that came twice."""
    repeats = np.zeros(len(time_s), bool)
    same = np.diff(time_s) == 0
    repeats[1:] = same & (np.diff(position_mm, axis=0) == 0).all(axis=1)
    return repeats


def _read_positions(table: Table, status: NDArray[np.int64]) -> NDArray[np.float64]:
    position_mm = np.empty((len(table), 3))
    for column, key in enumerate(_POSITION):
        position_mm[:, column] = table.numbers(key, nan=True)
        bad = np.isnan(position_mm[:, column]) & (status == 0)
        if bad.any():
            raise table.error(
                "is empty or NaN",
                int(np.argmax(bad)),
                key,
                "a sample without a position needs a status other than 0",
            )
    return position_mm


def _read_status(table: Table) -> NDArray[np.int64]:
    if "status" not in table.names:
        return np.zeros(len(table), np.int64)
    value = table.numbers("status")
    odd = (value != np.rint(value)) | (np.abs(value) > 2**53)
    if odd.any():
        index = int(np.argmax(odd))
        raise table.error(f"is {value[index]:g}, no whole number", index, "status")
    return value.astype(np.int64)
