"""Covariances as text."""

import base64
import zlib

import numpy as np
import pytest

from truepath.files.earlier.model_file import pack_symmetric, unpack_symmetric


@pytest.mark.parametrize("size", [0, 1, 2, 37])
def test_what_was_packed_comes_back_bit_for_bit(rng, size):
    scale = 10.0 ** rng.integers(-200, 200, (size, size))
    square = rng.standard_normal((size, size)) * scale
    symmetric = np.tril(square) + np.tril(square, -1).T
    assert (unpack_symmetric(pack_symmetric(symmetric), size) == symmetric).all()


def packed(*numbers):
    data = np.array(numbers, "<f8").tobytes()
    return base64.b64encode(zlib.compress(data)).decode()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("not base64!", "cannot be unpacked"),
        ("émile", "cannot be unpacked"),
        (base64.b64encode(b"no zlib").decode(), "cannot be unpacked"),
        (packed(1.0, 2.0), "size 2"),
        (packed(1.0, 2.0, 3.0, 4.0), "size 2"),
        (packed(1.0, np.nan, 3.0), "not finite"),
        (packed(1.0, 2.0, np.inf), "not finite"),
    ],
)
def test_a_damaged_text_is_refused(text, problem):
    with pytest.raises(ValueError, match=problem):
        unpack_symmetric(text, 2)


def test_a_text_that_unpacks_without_end_costs_no_memory():
    bomb = base64.b64encode(zlib.compress(bytes(50_000_000), 9)).decode()
    with pytest.raises(ValueError, match="size 2"):
        unpack_symmetric(bomb, 2)
