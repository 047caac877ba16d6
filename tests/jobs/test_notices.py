"""Notices are told once, kept with the job, and acted on as the order says."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from truepath.catalogue.live_notice import OnNotice
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.notices import NoticeBoard
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
    usual = {
        "number": 1,
        "kind": "something-changed",
        "grade": "possible",
        "axis": "",
        "since_row": 5,
        "noticed_row": 6,
        "noticed_s": 44.0,
        "size_um": 10.0,
        "uncertainty_um": 1.0,
        "is_over": False,
    }
    return {**usual, **more}


def board(followed, policy):
    n = 12
    path = Path(
        ("X", "Y", "Z"),
        np.arange(float(n))[:, None] * np.ones(3),
        np.full(n, 6000.0),
        np.zeros(n),
    )
    planned = PlannedRows(path)
    planned.next()
    planned.next()
    return NoticeBoard(followed, followed, policy, planned), planned


def test_a_notice_is_told_when_it_is_new_and_when_its_name_changes():
    followed = Followed()
    shown, _ = board(followed, OnNotice.NOTE)
    named = notice(kind="set-up-moved", grade="certain")
    for told in ([], [notice()], [notice(size_um=11.0)], [named], [named]):
        shown.show(told)
    kinds = [(kind, body["kind"]) for kind, body in followed.told]
    assert kinds == [("notice", "something-changed"), ("notice", "set-up-moved")]
    assert [n.kind for n in followed.kept] == ["set-up-moved"]
    assert followed.asked == []


def test_by_default_nothing_else_happens():
    followed = Followed()
    shown, planned = board(followed, OnNotice.NOTE)
    shown.show([notice()])
    assert planned.next().position[-1, 0] == 8.0
    assert followed.kept[0].action == "note"


def test_a_pause_holds_the_machine_once():
    followed = Followed()
    shown, _ = board(followed, OnNotice.PAUSE)
    for _ in range(3):
        shown.show([notice()])
    assert followed.asked == ["cell pause", "pause"], "the machine first"


def test_a_pause_for_a_notice_does_not_disturb_a_job_that_ends():
    """A hold while the last line is driven would end the job there."""
    followed = Followed()
    followed.may_move = False
    shown, _ = board(followed, OnNotice.PAUSE)
    shown.show([notice()])
    assert followed.asked == ["pause"]


@pytest.mark.parametrize(("policy", "back_to"), [("check", 3.0), ("replan", 4.0)])
def test_lines_are_measured_again_from_before_or_since_the_change(policy, back_to):
    followed = Followed()
    shown, planned = board(followed, OnNotice(policy))
    shown.show([notice()])
    assert planned.next().position[:, 0].min() == back_to
    assert followed.kept[0].action == policy
    shown.show([notice(grade="likely")])
    assert planned.next().position[-1, 0] == 8.0  # once


def test_who_is_asked_may_have_lines_measured_again():
    followed = Followed()
    shown, planned = board(followed, OnNotice.PAUSE)
    shown.show([notice()])
    followed.wish = OnNotice.CHECK
    shown.show([notice()])
    assert followed.kept[0].action == "check"
    assert planned.next().position[:, 0].min() == 3.0
