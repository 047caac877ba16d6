"""GeoCOM and T2SA without a wire: replies, frames and air."""

import math
import re

import numpy as np
import pytest
from geocompy.geo.gctypes import GeoComCode

from truepath_drivers.tracker.geocom import codec
from truepath_drivers.tracker.geocom.codec import is_point, parse_reply, to_cartesian_mm
from truepath_drivers.tracker.geocom.driver import find_humidity, find_wet_bulb
from truepath_drivers.tracker.t2sa import driver as t2sa


def test_return_codes_are_those_of_geocompy():
    known = {int(code) for code in GeoComCode}
    assert {int(code) for code in codec.ReturnCode} <= known


def test_the_frame_is_right_handed_with_z_up_and_both_faces_see_one_point():
    right = 0.5 * math.pi
    ways = ((right, right), (0.0, right), (0.0, 0.0))
    x, y, z = (to_cartesian_mm(hz, v, 1.0) for hz, v in ways)
    assert np.cross(x, y) == pytest.approx(1e3 * z, abs=1e-6)
    assert z == pytest.approx([0.0, 0.0, 1000.0], abs=1e-9)
    second = (1.0 + math.pi, 2.0 * math.pi - 1.4, 2.5)
    assert is_point(*second)
    first_mm = to_cartesian_mm(1.0, 1.4, 2.5)
    np.testing.assert_allclose(to_cartesian_mm(*second), first_mm, atol=1e-9)


def test_lines_that_are_no_replies_are_none_of_geocom_or_t2sa():
    for line in (b"", b"%R1P,0,1", b"R1P,0,1:0", b"%R1P,a,1:0", b"%R1Q,2108,1:5,1"):
        assert parse_reply(line) is None
    assert parse_reply(b"%R1P,0,3:0,1.5,2").values == (b"1.5", b"2")
    assert parse_reply(b"%R1P,0,3,48213:1292").code == 1292
    assert t2sa.parse_reply(b"ACK300") is None
    assert t2sa.parse_reply(b"ERR-305 no").code == t2sa.ErrorCode.POINT_FAILED
    measured = "Single Point Measurement p result 1,2,x a b c"
    assert t2sa.parse_point(measured, "p") is None


def test_a_wet_bulb_is_below_a_dry_one_unless_the_air_is_full():
    assert find_wet_bulb(20.0, 50.0) == pytest.approx(13.7, abs=0.05)  # Stull 2011
    assert find_humidity(20.0, find_wet_bulb(20.0, 35.0)) == pytest.approx(35.0)


@pytest.mark.parametrize("values", [b"", b",", b"1", b"1,", b',"a,b",', b'"",2'])
def test_values_are_split_at_commas_outside_of_quotes(values):
    reply = parse_reply(b"%R1P,0,4:0," + values)
    assert b",".join(reply.values) == values
    assert len(reply.values) == re.sub(rb'"[^"]*"', b"", values).count(b",") + 1
