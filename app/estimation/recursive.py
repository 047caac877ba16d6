"""The live estimator's sums: information of finished cells, added while more come.

Information adds (brunn-hanebeck-2005, eq. 31–33 in information form), but two things
reach beyond a cell. The Ornstein–Uhlenbeck part of the noise ties every cell to the
next: the last cell's Ornstein–Uhlenbeck part therefore stays in the sums as three
unknowns until the next cell has told about it. The timing of a line belongs to its
cells alone: once the line is finished, phase and speed are integrated out, given that
part. Both are exact, in any order of elimination, so the sums equal those of the batch
to rounding however the cells were split, and their size does not grow with the number
of lines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.alignment.reduction import beam_frame
from app.errors import EstimationError
from app.estimation.information import Information
from app.estimation.noise import NoiseModel, cell_noise
from app.kinematics.effects.base import Effect
from app.kinematics.effects.timing_law import TimingLaw
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.model import MachineModel
from app.numerics.correlated_noise import Tail, extended, without_columns
from app.numerics.rigid import RigidTransform

_TIMING = 2  # phase and speed of the line under way
_STANDING = -1
_NOTHING = 1e-12  # of the usual information on a timing parameter: rounding


@dataclass(frozen=True)
class Linearisation:
    """What must stay the same while cells are added.

    machine_model : effects of the machine proper
    pose : workpiece to tracker, about which the pose is linear; centre_mm : of its turn
    """

    machine_model: MachineModel
    pose: RigidTransform
    centre_mm: tuple[float, float, float]
    noise: NoiseModel

    @property
    def size(self) -> int:
        """Number of parameters of machine and pose."""
        return self.machine_model.size + 6


@dataclass(frozen=True)
class Recursive:
    """Sums over all cells so far.

    total : (p + 3, p + 3) over machine, pose, timing of the line under way, and data
    tail : what the last cell's Ornstein–Uhlenbeck noise will still take from them
    line : pass under way, -1 for none; time_s : of the last cell
    """

    about: Linearisation
    total: Float64[np.ndarray, "q q"]
    log_determinant: float = 0.0
    tail: Tail | None = None
    line: int = _STANDING
    time_s: float = -np.inf
    cells: int = 0

    def added(self, seen: Observations) -> Recursive:
        """Return the sums with further cells, which are later than all before.

        Raises EstimationError if they are not in order of time.
        """
        times = np.concatenate([[self.time_s], seen.at.time_s])
        if not (np.diff(times) > 0.0).all():
            raise EstimationError("cells have to be added in order of time")
        line = seen.at.line
        begins = np.flatnonzero(np.diff(line, prepend=line[:1] - 1))
        result = self
        for first, last in zip(begins, [*begins[1:], len(seen)], strict=True):
            result = result._with_part(seen.taken(np.arange(first, last)))
        return result

    def information(self) -> Information:
        """Return the information on machine and pose, all else integrated out."""
        done = self if self.line == _STANDING else self._line_finished()
        total, log_determinant = done.total, done.log_determinant
        if done.tail is not None:
            taken, log_taken = done.tail.taken()
            total, log_determinant = total - taken, log_determinant + log_taken
        p = self.about.size
        return Information(
            total[:p, :p], total[:p, -1], float(total[-1, -1]), log_determinant
        )

    def _with_part(self, seen: Observations) -> Recursive:
        """Return the sums with cells of one line, or of standstills."""
        line = int(seen.at.line[0])
        new_line = self.line not in (_STANDING, line)
        before = self._line_finished() if new_line else self
        rows, frame = _rows(self.about, seen)
        precision, ou = cell_noise(seen, self.about.noise, frame)
        gain, log_gain, tail = extended(
            before.tail,
            seen.at.time_s,
            precision,
            ou,
            self.about.noise.ou_time_s,
            rows,
        )
        return replace(
            before,
            total=before.total + gain,
            log_determinant=before.log_determinant + log_gain,
            tail=tail,
            line=line,
            time_s=float(seen.at.time_s[-1]),
            cells=before.cells + len(seen),
        )

    def _line_finished(self) -> Recursive:
        """Integrate phase and speed of the line under way out."""
        p = self.about.size
        told = [k for k in (p, p + 1) if self._is_told(k)]
        kept = np.r_[:p, p + _TIMING]
        square, turned, tail = without_columns(
            self.total, self.tail, kept, np.array(told, np.int64)
        )
        total = np.zeros_like(self.total)
        total[np.ix_(kept, kept)] = square
        if tail is not None:
            pulled = np.zeros((3, len(total)))
            pulled[:, kept] = tail.pulled
            tail = replace(tail, pulled=pulled)
        return replace(
            self,
            total=total,
            log_determinant=self.log_determinant + turned,
            tail=tail,
            line=_STANDING,
        )

    def _is_told(self, column: int) -> bool:
        """Tell whether the cells say anything of a timing parameter at all."""
        usual = np.diag(self.total)[self.about.machine_model.size :][:3].sum()
        return bool(self.total[column, column] > _NOTHING * usual)


def begun(about: Linearisation) -> Recursive:
    """Return the sums over no cells."""
    size = about.size + _TIMING + 1
    return Recursive(about, np.zeros((size, size)))


def _rows(
    about: Linearisation, seen: Observations
) -> tuple[Float64[np.ndarray, "n 3 q"], Float64[np.ndarray, "n 3 3"]]:
    """Return rows over machine, pose, timing and data, and the beam frame."""
    effects: list[Effect] = [TrackerPose(about.centre_mm)]
    line = int(seen.at.line[0])
    if line != _STANDING and np.isfinite(about.noise.along_sigma_mm):
        effects.append(TimingLaw((line,)))
    model = about.machine_model.with_effects(*effects)
    local = np.zeros((len(seen), 3, about.size + _TIMING + 1))
    local[:, :, : model.size] = model.jacobian(seen.at)
    local[:, :, -1] = about.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    frame = beam_frame(seen.tracker_mm) @ about.pose.rotation
    return np.matmul(frame, local), frame
