"""First row to repeat of a path whose stream is incomplete."""

from __future__ import annotations

from collections import deque

from truepath.measurement.progress import ProgressEstimator

_TICKS_HIT = 12  # looks of 0.1 s over which damage is detected late


class RowsToRepeat:
    """Keeps the first row whose stream was damaged, or whose target was lost.

    Also the rows with a standstill or missing samples: harmless for a line, whose other
    samples count, but they make an arc useless.
    """

    def __init__(self, progress: ProgressEstimator) -> None:
        self._progress = progress
        self._rows: deque[int] = deque(maxlen=_TICKS_HIT)
        self._hit_row: int | None = None
        self._lost_row: int | None = None
        self._broken_rows: set[int] = set()

    def follow(self, *, is_broken: bool) -> None:
        """Note the current row, once per look.

        is_broken : the machine is held, or samples are missing that were due recently
        """
        self._rows.append(self._progress.row)
        if is_broken and self._progress.stage == "measuring":
            self._broken_rows.update(self._rows)

    def note_damage(self) -> None:
        """Keep the row in which the damage of the stream began."""
        if self._progress.stage == "measuring" and self._hit_row is None:
            self._hit_row = self._rows[0]

    def note_loss(self) -> None:
        """Keep the row in which the target was lost."""
        if self._lost_row is None and self._progress.stage == "measuring":
            self._lost_row = self._rows[0]

    def discard_loss(self) -> None:
        """The target was recovered by an operator: no row is to be repeated."""
        self._lost_row = None

    def repeat_loss(self) -> None:
        """The target was recovered automatically: its line is to be repeated."""
        if self._progress.point is None and self._hit_row is None:
            self._hit_row = self._lost_row

    def pop_row(self) -> int | None:
        """First row since the last call that has to be repeated."""
        row, self._hit_row = self._hit_row, None
        return row

    def pop_broken_rows(self) -> frozenset[int]:
        """Rows since the last call with a standstill or missing samples."""
        rows, self._broken_rows = frozenset(self._broken_rows), set()
        return rows
