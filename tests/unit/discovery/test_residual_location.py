"""Where residuals are largest, and what they go with."""

import numpy as np
import pytest

from recorded import record_small
from truepath.discovery.discover import align_runs
from truepath.discovery.residual_location import locate_residual

ROW, UM = 9, 3.0


@pytest.fixture(scope="module")
def run():
    return record_small(3)[0]


@pytest.fixture(scope="module")
def seen(run):
    return align_runs([run])[0].observations


def test_the_worst_line_is_first_with_its_size_feed_axis_and_region(run, seen):
    residual_mm = np.where(seen.row[:, None] == ROW, [0.0, UM / 1e3, 0.0], 1e-4)
    *both, third = locate_residual(seen, residual_mm).segments[:3]
    assert [one.row for one in both] == [ROW, ROW]  # the line, and the stop at its end
    (worst,) = [one for one in both if one.axis]
    assert worst.rms_um == pytest.approx(UM)
    assert third.rms_um == pytest.approx(0.1 * 3**0.5)
    assert worst.feed_mm_min == pytest.approx(run.commanded.feed_mm_min[ROW], rel=0.01)
    begin, end = run.commanded.position[[ROW - 1, ROW]]
    axis = int(np.argmax(np.abs(end - begin)))
    assert worst.axis == run.machine.axis_names[axis]
    assert worst.direction == ("+" if end[axis] > begin[axis] else "-")
    for name, *ends in zip(run.machine.axis_names, begin, end, strict=True):
        low, _, high = worst.region.split(f"{name} ")[1].split(",")[0].partition(" to ")
        assert float(low) == pytest.approx(min(ends), abs=15.0)
        assert float(high or low) == pytest.approx(max(ends), abs=15.0)


@pytest.mark.parametrize("name", ["time", "beam", "position of Y", "direction of X"])
def test_what_the_residual_goes_with_has_the_greatest_share(seen, name):
    by = {
        "time": seen.at.time_s,
        "beam": np.linalg.norm(seen.tracker_mm, axis=1),
        "position of Y": seen.at.position_mm[:, 1],
        "direction of X": seen.at.approach[:, 0],
    }[name]
    residual_mm = 1e-3 * np.outer(by - np.average(by, weights=seen.count), [1, 1, 0])
    shares = locate_residual(seen, residual_mm).shares
    few = {key: share for key, share in shares.items() if key != "line"}
    assert max(few, key=few.get) == name
    assert few[name] > 0.9
