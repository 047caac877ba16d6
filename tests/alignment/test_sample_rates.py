"""Samples come at 50 Hz or at 5 kHz, on slow lines and fast ones."""

import pytest

from truepath.alignment.align import align
from truepath_simulators.worlds.synthetic import Setting


@pytest.mark.parametrize(
    ("rate_hz", "feed", "rows"), [(50.0, 3000.0, 12), (5000.0, 500.0, 4)]
)
def test_lines_are_found_at_any_rate(record, rate_hz, feed, rows):
    run, _ = record(5, rows=rows, feed=feed, setting=Setting(rate_hz=rate_hz))
    assert len(align(run).passes) >= rows - 1
