"""A broken link is opened again at pauses that grow, end, and differ by host."""

import itertools

import pytest

from truepath_drivers.cnc.modbus.commands import FIRST_S, LONGEST_S, BackOff

LOOK_S = 2e-3  # how finely it is looked when the next attempt is due


def pauses_s(back_off: BackOff, count: int = 12) -> list[float]:
    """How long each attempt has to wait for, found by asking every millisecond."""
    now_s, found = 0.0, []
    for _ in range(count):
        back_off.put_off(now_s)
        due_s = now_s
        while not back_off.is_due(due_s):
            due_s += 1e-3
        found.append(due_s - now_s)
        now_s = due_s
    return found


@pytest.mark.fault_row(16)
def test_pauses_grow_up_to_a_bound_and_begin_anew_once_the_link_came_back():
    found = pauses_s(BackOff(lambda: 1.0))
    assert found[0] == pytest.approx(FIRST_S, abs=LOOK_S)
    growing = [pause for pause in found if pause < LONGEST_S - LOOK_S]
    assert len(growing) >= 3
    assert all(b > 1.5 * a for a, b in itertools.pairwise(growing))
    assert found[len(growing) :] == pytest.approx([LONGEST_S] * 9, abs=LOOK_S)
    back_off = BackOff(lambda: 1.0)
    pauses_s(back_off)
    back_off.reset()
    assert back_off.is_due(0.0)
    assert pauses_s(back_off, 1)[0] == pytest.approx(FIRST_S, abs=LOOK_S)


@pytest.mark.fault_row(16)
def test_two_hosts_do_not_come_back_at_the_same_moments():
    early, late = (pauses_s(BackOff(lambda share=share: share)) for share in (0.0, 1.0))
    for soon, far in zip(early, late, strict=True):
        assert soon == pytest.approx(0.5 * far, abs=LOOK_S)
    drawn = {round(sum(pauses_s(BackOff(), 4)), 2) for _ in range(20)}
    assert len(drawn) > 5
