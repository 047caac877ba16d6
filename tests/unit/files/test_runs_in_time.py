"""When Runs were: by the computer's clock, by the tracker's, or as stated."""

from dataclasses import replace

import pytest

from truepath.errors import BadInput, BundleError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.runs_in_time import TimedRun, order_in_time
from truepath_simulators.machine_file import load_machine

MACHINE = machine_from_json({**load_machine("demo")}, file="machine.json")


def timed(name, span_s, started_s=None, machine=MACHINE, digest=None):
    return TimedRun(name, machine, digest or name, started_s, span_s)


def test_the_computers_clock_counts_where_every_run_has_it_else_the_trackers():
    runs = [timed("a", (0.0, 10.0)), timed("b", (100.0, 120.0), 5000.0)]
    assert order_in_time(runs, None).time_s == (5.0, 110.0)
    runs = [timed("a", (0.0, 10.0), 1000.0), timed("b", (0.0, 20.0), 5000.0)]
    assert order_in_time(runs, None).time_s == (1005.0, 5010.0)
    runs[1] = replace(runs[1], started_s=None)
    with pytest.raises(BadInput, match=r"begun anew between a and b.*--at, at_h"):
        order_in_time(runs, None)
    assert order_in_time(runs, [3.0, 4.0]).time_s == (3.0, 4.0)


def test_the_same_run_twice_is_named_with_its_digest():
    runs = [timed("a", (0.0, 1.0), digest="ab" * 32), timed("b", (5.0, 6.0))]
    runs.append(timed("c", (9.0, 10.0), digest="ab" * 32))
    with pytest.raises(BadInput, match=r"a and c are the same Run.*abababab"):
        order_in_time(runs, [0.0, 1.0, 2.0])


def test_runs_of_other_machines_tools_or_no_time_are_refused():
    run, spans = timed("a", (0.0, 1.0)), (5.0, 6.0)
    lathe = replace(MACHINE, name="lathe")
    with pytest.raises(BundleError, match="name is lathe"):
        order_in_time([run, timed("b", spans, machine=lathe)], None)
    moved = replace(MACHINE.targets[0], offset_mm=(0.0, 0.0, -1.0))
    other = replace(MACHINE, targets=(moved,))
    with pytest.raises(BadInput, match="b has other targets"):
        order_in_time([run, timed("b", spans, machine=other)], None)
    for times in ([0.0, 0.0], [1.0, 0.0], [0.0, float("nan")], [0.0, float("inf")]):
        with pytest.raises(BadInput, match="do not increase from a to b"):
            order_in_time([run, timed("b", spans)], times)
    with pytest.raises(BadInput, match="two at least"):
        order_in_time([run], [0.0])
