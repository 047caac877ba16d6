"""Notices are told once, kept with the job, and acted on as the order says."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from truepath.catalogue.live_notice import OnNotice
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.notices import NoticeBoard
from truepath.motion.configurations import Configurations
from truepath.motion.paths.planned_rows import PlannedRows
from truepath_drivers.interfaces.records import Path


@dataclass
class Followed:
    """Stands for the job and for the cell that drives it."""

    told: list = field(default_factory=list)
    kept: tuple = ()
    asked: list = field(default_factory=list)
    wish: OnNotice | None = None

    def publish(self, kind, body):
        self.told.append((kind, body))

    def store_values(self, notices):
        self.kept = notices

    may_move = True
    pause = ActiveJob.pause

    def apply_verb(self, verb):
        self.asked.append(str(verb))

    def send(self, verb):
        self.asked.append(f"cell {verb}")

    def take_wish(self):
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
        return NoticeBoard(followed, followed, policy, planned), planned

    return make


def test_a_notice_is_told_when_it_is_new_and_when_its_name_changes(followed, board):
    shown, planned = board(OnNotice.NOTE)
    shown.show([notice()])
    assert followed.kept[0].action == "note"
    named = notice(kind="set-up-moved", grade="certain")
    for told in ([], [notice()], [notice(size_um=11.0)], [named], [named]):
        shown.show(told)
    kinds = [(kind, body["kind"]) for kind, body in followed.told]
    assert kinds == [("notice", "something-changed"), ("notice", "set-up-moved")]
    assert [n.kind for n in followed.kept] == ["set-up-moved"]
    assert followed.asked == []
    assert planned.next().position[-1, 0] == 8.0, "nothing else happens"


@pytest.mark.parametrize(
    ("may_move", "asked"), [(True, ["cell pause", "pause"]), (False, ["pause"])]
)
def test_a_pause_holds_the_machine_once_and_first_unless_the_job_ends(
    followed, board, may_move, asked
):
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
def test_lines_are_measured_again_from_before_or_since_the_change_or_if_that_is_asked(
    followed, board, policy, wish, back_to
):
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
def test_what_is_driven_again_comes_between_by_ways_that_were_driven_and_counts(
    plan, repeated, driven
):
    planned = PlannedRows(*plan)
    planned.next()
    planned.repeat(repeated)
    assert drive(planned) == driven
    assert planned.total == len(driven) - isinstance(planned.driven, Path)
