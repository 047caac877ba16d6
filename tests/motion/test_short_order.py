"""The order of stops that takes least time."""

import numpy as np

from truepath.motion.motion_times import find_short_order


def test_a_short_order_has_no_stretch_that_is_better_turned_round(rng):
    at = rng.uniform(size=(40, 2))
    time_s = np.linalg.norm(at[:, None] - at, axis=2)
    order = find_short_order(time_s)
    assert order[0] == 0
    assert sorted(order) == list(range(40))
    length = time_s[order[:-1], order[1:]].sum()
    assert length < 0.45 * time_s[np.arange(39), np.arange(1, 40)].sum()
    for i in range(1, 40):
        for j in range(i + 1, 41):
            turned = np.r_[order[:i], order[i:j][::-1], order[j:]]
            assert time_s[turned[:-1], turned[1:]].sum() > length - 1e-9
