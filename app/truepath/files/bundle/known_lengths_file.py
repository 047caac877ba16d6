"""`known_lengths.csv`: lengths known otherwise, as the tracker has measured them.

A scale bar, the travel of an interferometer, the distance by a second tracker: x1_mm to
z2_mm are its ends in the tracker's frame, length_mm and u_mm its known value, with its
standard uncertainty. measured_mm is the tracker's own where it is not the distance of
the ends. With temperature_degC and expansion_um_per_m_K length_mm is that at 20 °C,
else that as it was measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truepath.errors import BundleError
from truepath.files.bundle.run import KnownLength, Run
from truepath.files.environment.refraction import MEASURED, find_factor
from truepath.files.tables import Table, encode_csv, read_csv

KNOWN_LENGTHS = "known_lengths.csv"
_ENDS = tuple(f"{axis}{end}_mm" for end in (1, 2) for axis in "xyz")
_COLUMNS = (*_ENDS, "length_mm", "u_mm", "measured_mm")
_THERMAL = ("temperature_degC", "expansion_um_per_m_K")
_AT_DEGC = 20.0
_SHORTEST_MM = 100.0
_MOST = 1000
_WRONG = 1e-3  # of the length: a slip of unit, point or row, no scale


def decode_known_lengths(
    data: bytes, *, file: str = KNOWN_LENGTHS
) -> tuple[KnownLength, ...]:
    """Lengths at the temperature of measurement. Raises BundleError."""
    table = read_csv(data, file)
    table.require_rows("leave out the file")
    if len(table) > _MOST:
        raise BundleError(
            f"has {len(table)} rows, more than {_MOST}",
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
    return encode_csv(dict(zip(_COLUMNS, np.array(rows).T, strict=True)))


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
