"""Covariance matrices as text: exact, and short enough for a JSON file."""

from __future__ import annotations

import base64
import zlib

import numpy as np
from jaxtyping import Float64

ENCODING = "base64, zlib, little-endian float64, lower triangle by rows"


def pack_symmetric(matrix: Float64[np.ndarray, "p p"]) -> str:
    """Return the lower triangle of a symmetric matrix in `ENCODING`."""
    triangle = matrix[np.tril_indices(len(matrix))].astype("<f8")
    return base64.b64encode(zlib.compress(triangle.tobytes(), 6)).decode("ascii")


def unpack_symmetric(text: str, size: int) -> Float64[np.ndarray, "p p"]:
    """Return the matrix of `pack_symmetric`. Raises ValueError if it is not one."""
    wanted = 8 * (size * (size + 1) // 2)
    unpacker = zlib.decompressobj()
    try:
        # Bounded, so that a short text cannot unpack to fill the memory.
        data = unpacker.decompress(base64.b64decode(text, validate=True), wanted + 1)
    except (ValueError, zlib.error) as error:
        raise ValueError(f"cannot be unpacked ({error})") from error
    if len(data) != wanted or not unpacker.eof:
        raise ValueError(f"does not hold a matrix of size {size}")
    triangle = np.frombuffer(data, "<f8").astype(np.float64)
    if not np.isfinite(triangle).all():
        raise ValueError("holds numbers that are not finite")
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = triangle
    return lower + np.tril(lower, -1).T
