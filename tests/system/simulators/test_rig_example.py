import numpy as np
import pytest

from truepath.plugins import load


@pytest.mark.truepath_bench(seed=7, tracker="tcp")
def test_our_software_notices_a_broken_beam(truepath_bench):
    make_tracker = load("truepath.trackers", "streaming")
    with make_tracker(**truepath_bench.tracker_options) as tracker:
        tracker.start(500.0)
        assert (tracker.read(2.0).status == 0).all()
        assert truepath_bench.read_state()["tracker"]["streaming"]
        truepath_bench.inject("tracker:beam-break")
        while (block := tracker.read(2.0)).status[-1] == 0:
            assert len(block)
    assert truepath_bench.read_state()["cnc"]["state"] == "idle"


def test_a_rig_knows_its_errors(truepath_bench):
    corner, middle = truepath_bench.truth_at([[0, 0, 0], [250, 200, 150]])
    assert np.linalg.norm(corner - middle) > 0.1  # µm
