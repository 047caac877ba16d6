"""Changes detected during a measurement, named where one explanation is clear.

A change is noticed as soon as it exceeds what chance rarely produces
(`change_detection`). It is named where every other kind explains it clearly worse; else
only its start is known. Lines that follow may name it, rename it, or show that it is
over. A notice is never withdrawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.change_detection import LASTING, Change, ChangeSearch
from truepath.estimation.checks.running_sums import WatchSums
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.estimation.problem.information import Information

UNNAMED = "something-changed"
_LIKELY, _CERTAIN = 8.0, 20.0  # by how much the next kind explains less
_FEWEST, _FEWEST_POINTS = 8, 24  # enough to determine machine and noise
_NEAR = 2  # rows: changes as near as that are one


@dataclass(frozen=True, slots=True)
class Notice:
    """One change that was detected during a measurement.

    number : 1, 2, … of the measurement
    kind : of the change, `something-changed` if unnamed; axis : empty unless it
        concerns one
    grade : `certain`, `likely` or `possible`, as in discovery
    since_row : first line or point that shows it; noticed_row : the last one finished
        when it was noticed; noticed_s : when, on the tracker's clock
    size_mm : displacement of the measured points; sigma_mm : its standard uncertainty
    is_over : the newest lines no longer show it
    """

    number: int
    kind: str
    axis: str
    grade: str
    since_row: int
    noticed_row: int
    noticed_s: float
    size_mm: float
    sigma_mm: float
    is_over: bool = False


class ChangeWatch:
    """Monitors the lines (or points) of one measurement for changes."""

    def __init__(self, *, has_lines: bool) -> None:
        self._fewest = _FEWEST if has_lines else _FEWEST_POINTS
        self._sums: WatchSums | None = None
        self._notices: tuple[Notice, ...] = ()

    def start_again(self, about: Linearisation, seen: Sequence[Observations]) -> None:
        """Rebuild the sums from all lines so far, linearised about a new solution."""
        self._sums = WatchSums.start(about, seen)

    def add(self, line: Observations) -> None:
        """Next line or standstill, before any exclusion of cells."""
        if self._sums is not None:
            self._sums = self._sums.add([line])

    def list_notices(self, known: Information, time_s: float) -> tuple[Notice, ...]:
        """All notices so far, by number.

        known : information on machine and pose from other sources than the lines;
            time_s : now
        """
        sums = self._sums
        if sums is None or len(set(sums.row)) < self._fewest:
            return self._notices
        rows = {each.since_row for each in self._notices}
        before = [k for k, row in enumerate(sums.row) if row in rows]
        found = ChangeSearch(sums, known, before).find()
        self._notices = revise(self._notices, found, sums.row, time_s)
        return self._notices


def revise(
    before: Sequence[Notice], found: Sequence[Change], row: Sequence[int], time_s: float
) -> tuple[Notice, ...]:
    """Notices updated with the changes of another search.

    row : of each line so far
    """
    notices = {each.number: replace(each, is_over=True) for each in before}
    known: set[int] = set()
    told = [_describe(change, len(before) + 1, row, time_s) for change in found]
    # An unnamed change may turn out to have begun elsewhere.
    vague = [
        n
        for n in before
        if n.kind == UNNAMED and not n.is_over and not any(_is_same(n, t) for t in told)
    ]
    for new in told:
        like = [n for n in before if _is_same(n, new)] + vague
        same = next((n for n in like if n.number not in known), None)
        number = len(notices) + 1
        if same is not None:
            number = same.number
            new = replace(new, noticed_row=same.noticed_row, noticed_s=same.noticed_s)
        known.add(number)
        notices[number] = replace(new, number=number)
    return tuple(notices[number] for number in sorted(notices))


def _describe(change: Change, number: int, row: Sequence[int], time_s: float) -> Notice:
    """A change on the newest line only stays unnamed: a shift of this line and one of
    all that follows are indistinguishable.
    """
    is_named = change.margin >= _LIKELY and row[change.onset] != row[-1]
    grade = "certain" if change.margin >= _CERTAIN else "likely"
    return Notice(
        number,
        change.kind if is_named else UNNAMED,
        change.axis if is_named else "",
        grade if is_named else "possible",
        row[change.onset],
        row[-1],
        time_s,
        change.size_mm,
        change.sigma_mm,
    )


def _is_same(old: Notice, new: Notice) -> bool:
    if old.kind == new.kind and old.kind in LASTING:
        return True
    return abs(old.since_row - new.since_row) <= _NEAR
