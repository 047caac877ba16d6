"""Covariance matrices in JSON files: as text, exact and short."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.documents.file_model import FileModel, Text, quote, reject

ENCODING = "base64, zlib, little-endian float64, lower triangle by rows"
AS_WRITTEN = "take the file as it was written"
_MOST = 20_000  # rows; a larger matrix would not fit in memory


class CovarianceFile(FileModel):
    """The covariance of the numbers of the effects, one effect after another."""

    size: int
    encoding: str
    data: Text

    def matrix(self, size: int) -> Float64[np.ndarray, "s s"]:
        """Raises a refusal unless it is of the size of all numbers of the effects."""
        if self.size != size or size > _MOST:
            problem = f"is {self.size}, the effects state {size} numbers"
            raise reject(problem, "", "covariance", "size")
        if self.encoding != ENCODING:
            remedy = f"write one of {ENCODING}"
            place = "covariance", "encoding"
            raise reject(f"is {quote(self.encoding)}", remedy, *place)
        try:
            covariance = unpack_symmetric(self.data, size)
        except ValueError as error:
            raise reject(str(error), AS_WRITTEN, "covariance", "data") from error
        if (np.diag(covariance) < 0.0).any():
            problem = "states a negative variance"
            raise reject(problem, AS_WRITTEN, "covariance", "data")
        return covariance


def covariance_json(covariance: Float64[np.ndarray, "s s"]) -> dict[str, Any]:
    """Content of the key `covariance` of a model."""
    return {
        "of": "the numbers of the effects, one effect after another",
        "size": len(covariance),
        "encoding": ENCODING,
        "data": pack_symmetric(covariance),
    }


def pack_symmetric(matrix: Float64[np.ndarray, "p p"]) -> str:
    """Lower triangle of a symmetric matrix in `ENCODING`."""
    triangle = matrix[np.tril_indices(len(matrix))].astype("<f8")
    return base64.b64encode(zlib.compress(triangle.tobytes(), 6)).decode("ascii")


def unpack_symmetric(text: str, size: int) -> Float64[np.ndarray, "p p"]:
    """Inverse of `pack_symmetric`. Raises ValueError."""
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
