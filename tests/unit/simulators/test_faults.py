import numpy as np
import pytest

from truepath_simulators.errors import SimulatorError
from truepath_simulators.faults import Fault, Schedule, parse_fault


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("tracker:silence@12s+0.5s", Fault("tracker", "silence", 12.0, "s", 0.5, 0.0)),
        ("tracker:bit-flip@5s+9s*.1", Fault("tracker", "bit-flip", 5.0, "s", 9.0, 0.1)),
        ("tracker:spike@800n*.3", Fault("tracker", "spike", 800.0, "n", None, 0.3)),
        ("cnc:alarm@row5", Fault("cnc", "alarm", 5.0, "row", None, 1001.0)),
        ("cnc:feed-hold+2s", Fault("cnc", "feed-hold", None, "s", 2.0, 0.0)),
        ("cnc:wrong-identity", Fault("cnc", "wrong-identity")),
    ],
)
def test_a_fault_is_read_from_its_text(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    "text", ["", "tracker", "tracker:explode", "cnc:spike", "tracker:silence@12", "x:y"]
)
def test_what_is_not_understood_is_said(text):
    with pytest.raises(SimulatorError, match="fault"):
        parse_fault(text)


def struck(schedule, kind, time_s):
    hits = schedule.struck(kind, time_s, np.arange(len(time_s)))
    return [float(t) for _, mask in hits for t in time_s[mask]]


def test_time_counts_from_the_begin_or_from_when_a_fault_is_added():
    schedule = Schedule([parse_fault("tracker:silence@2s+1s")])
    moments = np.arange(0.0, 10.0, 0.5)
    assert struck(schedule, "silence", moments) == []
    schedule.begin(3.0)
    assert struck(schedule, "silence", moments) == [5.0, 5.5]
    lasting = Schedule([parse_fault("cnc:wrong-identity")])
    assert lasting.strikes("wrong-identity", 0.0)
    assert not lasting.strikes("silence", 0.0)
    schedule = Schedule([])
    schedule.add(parse_fault("tracker:silence+1s"), 50.0)
    schedule.add(parse_fault("tracker:delay@5s+1s"), 50.0)
    assert schedule.strikes("silence", 50.0)
    assert not schedule.strikes("silence", 51.0)
    assert not schedule.strikes("delay", 54.0)
    assert schedule.strikes("delay", 55.0)


def test_a_fault_can_begin_with_a_sample_or_a_row_and_strikes_once_without_a_duration():
    schedule = Schedule([parse_fault("tracker:drop@1s")])
    schedule.begin(0.0)
    assert struck(schedule, "drop", np.arange(0.0, 1.0, 0.25)) == []
    assert struck(schedule, "drop", np.arange(1.0, 2.0, 0.25)) == [1.0]
    assert struck(schedule, "drop", np.arange(2.0, 3.0, 0.25)) == []
    schedule = Schedule(map(parse_fault, ["tracker:spike@3n", "cnc:alarm@row2+9s"]))
    schedule.begin(0.0)
    assert struck(schedule, "spike", np.array([0.1, 0.2, 0.3, 0.4])) == [0.4]
    assert not schedule.strikes("alarm", 1.0, 1)
    assert schedule.strikes("alarm", 2.0, 2)
    assert schedule.strikes("alarm", 10.9, 3)
    assert not schedule.strikes("alarm", 11.1, 3)


def test_time_counts_anew_for_what_has_not_struck_yet():
    schedule = Schedule(map(parse_fault, ["tracker:silence@5s", "tracker:delay@1s"]))
    schedule.add(parse_fault("tracker:beam-break@5s"), 0.0)
    schedule.begin(0.0)
    assert schedule.strikes("delay", 2.0)
    schedule.start_over()
    assert not schedule.strikes("silence", 6.0)
    schedule.begin(6.0)
    assert not schedule.strikes("silence", 10.0)
    assert schedule.strikes("silence", 11.0)
    assert schedule.strikes("delay", 6.0)
    assert schedule.strikes("beam-break", 5.0)
