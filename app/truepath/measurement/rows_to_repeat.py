"""From which row on a path has to be driven again, for what its stream lacks."""

from __future__ import annotations

from collections import deque

from truepath.measurement.progress import ProgressEstimator

_TICKS_HIT = 12  # looks, a tenth of a second each, over which damage is noticed late


class RowsToRepeat:
    """Keeps the first row whose stream was damaged, or whose target was lost.

    Beside it the rows on which the machine stood or samples are missing: nothing to a
    line, of which what was seen counts, but an arc then tells nothing.
    """

    def __init__(self, progress: ProgressEstimator) -> None:
        self._progress = progress
        self._rows: deque[int] = deque(maxlen=_TICKS_HIT)
        self._hit_row: int | None = None
        self._lost_row: int | None = None
        self._broken_rows: set[int] = set()

    def follow(self, *, is_broken: bool) -> None:
        """Take note of the row under way, once a look.

        is_broken : the machine is held, or samples are missing that were due of late
        """
        self._rows.append(self._progress.row)
        if is_broken and self._progress.stage == "measuring":
            self._broken_rows.update(self._rows)

    def note_damage(self) -> None:
        """The stream is damaged: keep the row that it began in."""
        if self._progress.stage == "measuring" and self._hit_row is None:
            self._hit_row = self._rows[0]

    def note_loss(self) -> None:
        """The target is lost: keep the row that it was lost in."""
        if self._lost_row is None and self._progress.stage == "measuring":
            self._lost_row = self._rows[0]

    def forget_loss(self) -> None:
        """The target is not lost any more, and a person saw to it."""
        self._lost_row = None

    def repeat_loss(self) -> None:
        """Nobody went back to where the target was lost: drive its line again."""
        if self._progress.point is None and self._hit_row is None:
            self._hit_row = self._lost_row

    def take(self) -> int | None:
        """Return the first row since the last call that has to be driven again."""
        row, self._hit_row = self._hit_row, None
        return row

    def take_broken(self) -> frozenset[int]:
        """Return the rows since the last call that were not driven or seen whole."""
        rows, self._broken_rows = frozenset(self._broken_rows), set()
        return rows
