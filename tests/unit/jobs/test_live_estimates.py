"""What a live estimate tells and is remembered of; what is done about its notices."""

from dataclasses import dataclass, field
from multiprocessing import Pipe

import numpy as np
import pytest

from job_builders import make_samples
from truepath.catalogue.job import JobEvent, OnNotice
from truepath.estimation.live.live_model import LiveEstimate
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.running import live_estimation, live_process
from truepath.jobs.running.active_job import JOBS, ActiveJob, EventBus
from truepath.kinematics.effects.error_motion import AxisLocation
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.motion.configurations import Configurations
from truepath.motion.paths.plan_segments import PlannedRows
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators.machine_file import load_machine


@pytest.fixture
def order(mill, square):
    return live_process.LiveEstimateOrder(mill, square)


def test_what_has_no_room_is_dropped_and_counted_at_once(order):
    live = live_estimation.LiveEstimation(order, lambda _: None)
    for _ in range(live_estimation.WAITING_BLOCKS + 7):
        live.offer(make_samples())
    assert live.dropped_blocks == 7
    live.close()


def test_a_stream_that_is_no_measurement_ends_without_a_word(order):
    ours, theirs = Pipe()
    ours.send(TrackerSamples.empty())
    ours.send(live_process.LiveCommand.END)
    live_process.estimate_live(order, theirs)
    assert not ours.poll()


def test_the_newest_estimates_of_a_few_jobs_are_remembered_each_with_its_course():
    event_bus = EventBus()
    estimates = event_bus.estimates

    def publish(job_id, done, sigma_um):
        notices = {"done": done, "elapsed_s": 5.0 * done}
        notices["volumetric_uncertainty_um"] = sigma_um
        event_bus.publish(JobEvent("estimate", job_id, notices))
        return notices

    publish("0", 1, 1.0)
    for done, sigma_um in ((2, 9.0), (2, 9.0), (3, 4.0), (3, 4.0), (3, 3.0)):
        newest = publish("1", done, sigma_um)
    for number in range(2, JOBS + 1):
        publish(str(number), 1, 1.0)
    assert estimates.newest("0") is None
    assert estimates.course("0")["done"] == []
    assert estimates.newest("1") == newest
    course = {"elapsed_s": [10.0, 15.0, 15.0], "done": [2, 3, 3]}
    course["volumetric_uncertainty_um"] = [9.0, 4.0, 3.0]
    assert estimates.course("1") == course


def test_tables_of_a_rotary_axis_are_over_degrees_with_where_the_axes_are(rng):
    content = load_machine("head-table")
    content["axes"]["X"]["max_mm"] = 1000.0 / 3.0
    machine = machine_from_json(content)
    offsets = {t.name: np.array([t.offset_mm]) for t in machine.targets}
    model, _ = build_identifiable_model(machine, np.concatenate(list(offsets.values())))
    theta = rng.normal(scale=1e-3, size=model.size)
    covariance = np.diag(rng.uniform(1e-5, 1e-4, model.size) ** 2)
    estimate = LiveEstimate(model, theta, covariance, 2e-3, 12, 480, 61.5)
    notices = live_process.estimate_json(estimate)
    tables, places = notices["error_tables"], notices["axis_location"]
    for symbol, table in tables.items():
        place = "position_deg" if symbol[2] in "ABC" else "position_mm"
        value = "um" if symbol[1] in "XYZ" else "urad"
        assert set(table) == {place, f"value_{value}", f"uncertainty_{value}"}
        for numbers in table.values():  # on a bus for all panels: no longer than needed
            assert numbers == [round(number, 3) for number in numbers]
    turning = [table for symbol, table in tables.items() if symbol[2] in "ABC"]
    assert any(max(table["position_deg"]) == 360.0 for table in turning)
    effects = [e for e in model.effects if isinstance(e, AxisLocation)]
    assert {e.symbol for e in effects} == set(places)
    for effect in effects:
        part = model.slices[effect.name]
        value, sigma = theta[part][0], np.sqrt(covariance[part, part][0, 0])
        unit, scale = ("um", 1e3) if effect.symbol[0] in "XYZ" else ("urad", 1e6)
        entry = places[effect.symbol]
        assert entry[f"value_{unit}"] == pytest.approx(scale * value, abs=1e-3)
        assert entry[f"uncertainty_{unit}"] == pytest.approx(scale * sigma, abs=1e-3)


@dataclass
class Followed:
    notices: list = field(default_factory=list)
    kept: tuple = ()
    asked: list = field(default_factory=list)
    wish: OnNotice | None = None

    def publish(self, kind, body):
        self.notices.append((kind, body))

    def store_values(self, notices):
        self.kept = notices

    may_move = True
    pause = ActiveJob.pause

    def apply_verb(self, verb):
        self.asked.append(str(verb))

    def send(self, verb):
        self.asked.append(f"cell {verb}")

    def pop_notice_action(self):
        wish, self.wish = self.wish, None
        return wish


def notice(**more):
    usual = {"number": 1, "kind": "something-changed", "grade": "possible", "axis": ""}
    usual |= {"since_row": 5, "noticed_row": 6, "noticed_s": 44.0}
    return {**usual, "size_um": 10.0, "uncertainty_um": 1.0, "is_over": False, **more}


def path(rows=8):
    position = np.arange(float(rows))[:, None] * np.ones(3)
    return Path(("X", "Y", "Z"), position, np.full(rows, 6000.0), np.zeros(rows))


def points(rows=5):
    return Configurations(("X", "Y", "Z"), path(rows).position, np.ones(rows))


def drive(planned):
    while planned.next() is not None:
        pass
    return planned.driven.position[:, 0].tolist()


@pytest.fixture
def followed():
    return Followed()


@pytest.fixture
def board(followed):
    """Makes a board whose job has begun its third part; returns it and its rows."""

    def make(policy):
        planned = PlannedRows(path(12))
        planned.next()
        planned.next()
        return live_estimation.LiveAlerts(followed, followed, policy, planned), planned

    return make


def test_a_notice_is_told_when_it_is_new_and_when_its_name_changes(followed, board):
    shown, planned = board(OnNotice.NOTE)
    shown.show([notice()])
    assert followed.kept[0].action == "note"
    named = notice(kind="set-up-moved", grade="certain")
    for notices in ([], [notice()], [notice(size_um=11.0)], [named], [named]):
        shown.show(notices)
    kinds = [(kind, body["kind"]) for kind, body in followed.notices]
    assert kinds == [("notice", "something-changed"), ("notice", "set-up-moved")]
    assert [n.kind for n in followed.kept] == ["set-up-moved"]
    assert followed.asked == []
    assert planned.next().position[-1, 0] == 8.0, "nothing else happens"


@pytest.mark.parametrize(
    ("may_move", "asked"), [(True, ["cell pause", "pause"]), (False, ["pause"])]
)
def test_a_pause_first_holds_once_unless_the_job_ends(followed, board, may_move, asked):
    """A hold while the last line is driven would end the job there."""
    followed.may_move = may_move
    shown, _ = board(OnNotice.PAUSE)
    for _ in range(3):
        shown.show([notice()])
    assert followed.asked == asked


@pytest.mark.parametrize(
    ("policy", "wish", "back_to"),
    [("check", None, 3.0), ("replan", None, 4.0), ("pause", "check", 3.0)],
)
def test_lines_before_a_change_are_driven_again(followed, board, policy, wish, back_to):
    shown, planned = board(OnNotice(policy))
    shown.show([notice()])
    if wish is not None:
        followed.wish = OnNotice(wish)
        shown.show([notice()])
    assert planned.next().position[:, 0].min() == back_to
    assert followed.kept[0].action == (wish or policy)
    shown.show([notice(grade="likely")])
    assert planned.next().position[-1, 0] == 8.0  # once


def test_the_parts_are_the_whole_plan_and_end_however_often_lines_are_asked_for():
    planned = PlannedRows(path())
    assert planned.total == 7
    assert len(planned.driven) < 8
    assert drive(planned) == list(range(8))
    often = PlannedRows(path())
    for _ in range(40):
        often.repeat(1)
        if often.next() is None:
            break
    assert often.next() is None
    assert often.driven.position[-1, 0] == 7.0
    far = PlannedRows(path(20))
    for _ in range(6):
        far.next()
    far.repeat(0)
    assert far.next().position[:, 0].min() == 8.0, "six lines back at most"


@pytest.mark.parametrize(
    ("plan", "repeated", "driven"),
    [
        ([path()], 3, [0, 1, 2, 3, 4, 3, 2, 3, 4, 5, 6, 7]),
        ([path(3)], 2, [0, 1, 2, 1, 2]),
        ([points()], 3, [0, 1, 2, 3, 3, 4]),
        ([points(), lambda *_: False], 1, [0, 1, 2, 3, 2, 1, 2, 3, 4]),
    ],
    ids=["before the rest", "the last lines", "points", "points behind a box"],
)
def test_rows_driven_again_come_between_by_known_ways_and_count(plan, repeated, driven):
    planned = PlannedRows(*plan)
    planned.next()
    planned.repeat(repeated)
    assert drive(planned) == driven
    assert planned.total == len(driven) - isinstance(planned.driven, Path)
