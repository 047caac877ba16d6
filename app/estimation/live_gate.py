"""New lines of a measurement under way, held against what the lines before foretell.

So a burst or a moved reflector does not get into the numbers shown (`innovation`). What
does not fit is held back until all lines are looked at together (`checked_parts`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truepath.app.alignment.left_out import LeftOut
from truepath.app.alignment.observations import Observations
from truepath.app.estimation.contradictions import MOST, stand_out
from truepath.app.estimation.design_matrix import Linearisation
from truepath.app.estimation.information import Posterior
from truepath.app.estimation.innovation import compute_innovation
from truepath.app.estimation.run_parts import Knock, leave_out


@dataclass(frozen=True, slots=True)
class LiveCheck:
    """What a measurement under way says of itself.

    left_out : valid samples that are not used; knocks : at which the Run was split
    used_samples, cells : that the estimate is made from
    held : rows of the newest lines, which do not fit what came before; held_mm : by
        how far at the most
    residual, white : of the fit and of a sample, over what the tracker states
    """

    left_out: tuple[LeftOut, ...] = ()
    knocks: tuple[Knock, ...] = ()
    used_samples: int = 0
    cells: int = 0
    held: tuple[int, ...] = ()
    held_mm: float = 0.0
    residual: float = 1.0
    white: float = 1.0


@dataclass(frozen=True, slots=True)
class LineGate:
    """Holds new lines against what is foretold of them.

    squares : of the shifts of lines that were let in; cells : tested so far
    held : rows of the newest lines, which were not let in; held_mm : by how far they
        lie off at the most
    """

    squares: tuple[float, ...] = ()
    cells: int = 0
    held: tuple[int, ...] = ()
    held_mm: float = 0.0

    def check(
        self, about: Linearisation, foretold: Posterior, line: Observations
    ) -> tuple[LineGate, Observations]:
        """Return the gate after a line, and what of the line goes in."""
        found = compute_innovation(about, foretold, line)
        tested, edges = self.cells + len(line), np.arange(len(line) + 1)
        bad = stand_out(found.cell, among=tested)
        if bad.any() and bad.mean() < MOST:
            kept = leave_out(line, bad, found.off_mm, edges)
            return self.check(about, foretold, kept) if len(kept) else (self, kept)
        square, usual = np.array([found.line]), np.array(self.squares or (0.0,))
        if not bad.any() and not stand_out(square, usual, len(usual))[0]:
            return LineGate((*self.squares, found.line), tested), line
        off_mm = float(found.off_mm.max()) if bad.any() else found.moved_mm
        gate = replace(
            self,
            cells=tested,
            held=tuple(sorted({*self.held, int(line.row[0])})),
            held_mm=max(self.held_mm, off_mm),
        )
        bad = np.ones(len(line), bool)
        return gate, leave_out(line, bad, found.off_mm, edges)
