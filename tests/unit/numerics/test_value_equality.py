"""Dataclasses with arrays are equal and hashable by content."""

from dataclasses import dataclass, replace

import numpy as np

from truepath.kinematics.splines import natural_spline
from truepath.numerics.value_equality import ValueEquality


@dataclass(frozen=True)
class Record(ValueEquality):
    values: np.ndarray
    inner: object
    keys: dict


def a_record(last=3.0):
    knots = np.array([0.0, 1.0, last])
    return Record(np.array([1.0, 2.0]), natural_spline(knots), {"axis": "X"})


def test_equal_content_is_equal_and_hashes_alike_and_other_content_is_not():
    assert a_record() == a_record()
    assert hash(a_record()) == hash(a_record())
    assert a_record() != a_record(last=4.0)
    assert a_record() != replace(a_record(), keys={"axis": "Y"})
    assert a_record() != replace(a_record(), values=np.array([1.0, 2.5]))
