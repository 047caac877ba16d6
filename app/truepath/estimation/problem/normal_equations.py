"""Normal equations of cells in time order, all at once or one by one.

Information adds (brunn-hanebeck-2005, eq. 31–33 in information form), but two things
reach beyond a cell. The Ornstein–Uhlenbeck noise couples every cell to the next: the
state of the last cell's noise therefore stays in the sums as three unknowns until the
next cell is added. The timing of a line belongs to its cells alone: once the line is
finished, phase and speed are integrated out, given that state. Both are exact, in any
order of elimination, so the sums do not depend on how the cells were split.

The machine is common to all Runs; the tracker's position and the noise of the air
belong to one. So the pose is integrated out of the information of each Run, which loses
nothing (it has no prior), and the rest, on the machine's parameters, adds. Time and
memory grow with the number of Runs, the solve does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.errors import EstimationError, Unidentifiable
from truepath.estimation.problem.design_matrix import (
    DesignMatrix,
    Linearisation,
    linearise,
)
from truepath.estimation.problem.information import (
    Information,
    OwnParameters,
    add_information,
    find_informative,
)
from truepath.estimation.problem.noise import NoiseModel, cell_noise
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.model import MachineModel
from truepath.numerics.correlated_noise import (
    OrnsteinUhlenbeckState,
    eliminate_columns,
    extend,
)
from truepath.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """Products of all columns over the cells so far.

    total : (q, q) over fixed parameters, data, and the timing of unfinished lines
    fixed : number of parameters of machine and poses; lines : unfinished ones
    state : of the last cell's Ornstein–Uhlenbeck noise
    """

    total: Float64[np.ndarray, "q q"]
    fixed: int
    log_determinant: float = 0.0
    state: OrnsteinUhlenbeckState | None = None
    lines: tuple[int, ...] = ()

    @staticmethod
    def empty(fixed: int) -> NormalEquations:
        return NormalEquations(np.zeros((fixed + 1, fixed + 1)), fixed)

    def add(self, design: DesignMatrix, noise: NoiseModel) -> NormalEquations:
        """Adds cells later than all before.

        Raises Unidentifiable if the timing of a finished line is not determined.
        """
        if self.lines and self.lines != design.lines:
            return self.finish_lines().add(design, noise)
        before = self._widen(design.rows.shape[2])
        precision, ou_sigma = cell_noise(design.observations, noise, design.travel)
        time_s = design.observations.at.time_s
        gain, log_gain, state = extend(
            before.state, time_s, precision, ou_sigma, noise.ou_time_s, design.rows
        )
        return replace(
            before,
            total=before.total + gain,
            log_determinant=before.log_determinant + log_gain,
            state=state,
            lines=design.lines,
        )

    def finish_lines(self) -> NormalEquations:
        if not self.lines:
            return self
        kept = self.fixed + 1
        timing = kept + find_informative(np.diag(self.total)[kept:])
        try:
            total, gain, state = eliminate_columns(
                self.total, self.state, np.arange(kept), timing
            )
        except np.linalg.LinAlgError as error:
            raise Unidentifiable(
                "the timing of a line is not determined; use longer lines"
            ) from error
        log_determinant = self.log_determinant + gain
        return NormalEquations(total, self.fixed, log_determinant, state)

    def information(self) -> Information:
        done = self.finish()
        return Information.from_total(done.total, done.log_determinant)

    def finish(self) -> NormalEquations:
        """Integrates out all coupling to later cells."""
        done = self.finish_lines()
        if done.state is None:
            return done
        state, log_state = done.state.marginalise()
        return replace(
            done,
            total=done.total - state,
            log_determinant=done.log_determinant + log_state,
            state=None,
        )

    def _widen(self, width: int) -> NormalEquations:
        more = width - len(self.total)
        if not more:
            return self
        state = self.state
        if state is not None:
            state = replace(state, pulled=np.pad(state.pulled, ((0, 0), (0, more))))
        return replace(self, total=np.pad(self.total, (0, more)), state=state)


def compute_information(
    observations: Observations, linearisation: Linearisation, *, apart: bool = False
) -> Information:
    """Information of all cells on machine and poses.

    apart : correlate noise within each block of cells only, not between blocks

    Raises Unidentifiable if the timing of a line is not determined.
    """
    noises = [linearisation.noise]
    return compute_under(observations, linearisation, noises, apart=apart)[0]


def compute_under(
    observations: Observations,
    linearisation: Linearisation,
    noises: Sequence[NoiseModel],
    *,
    apart: bool = False,
    along: Float64[np.ndarray, "m r"] | None = None,
) -> list[Information]:
    """Information of all cells under each noise, from one pass over them.

    along : directions of the first m parameters, all others held: the information is on
        the r amplitudes

    As `compute_information`.
    """
    size = linearisation.size if along is None else along.shape[1]
    sums = [NormalEquations.empty(size) for _ in noises]
    for design in linearisation.split(observations):
        if along is not None:
            design = design.restrict_to(along)
        sums = [s.add(design, n) for s, n in zip(sums, noises, strict=True)]
        if apart:
            sums = [s.finish() for s in sums]
    return [s.information() for s in sums]


@dataclass(frozen=True)
class RecursiveEstimator:
    """All cells so far under one linearisation.

    time_s : of the last cell
    """

    linearisation: Linearisation
    sums: NormalEquations
    time_s: float = -np.inf
    cells: int = 0

    @staticmethod
    def start(linearisation: Linearisation) -> RecursiveEstimator:
        return RecursiveEstimator(
            linearisation, NormalEquations.empty(linearisation.size)
        )

    def add(self, observations: Observations) -> RecursiveEstimator:
        """Adds cells later than all before.

        Raises EstimationError if they are not in order of time.
        """
        time_s, line = observations.at.time_s, observations.at.line
        if not (np.diff(time_s, prepend=self.time_s) > 0.0).all():
            raise EstimationError("cells have to be added in order of time")
        sums = self.sums
        begins = np.flatnonzero(np.diff(line, prepend=line[:1] - 1))
        for cells in np.split(np.arange(len(observations)), begins[1:]):
            design = self.linearisation.build(observations.select(cells))
            sums = sums.add(design, self.linearisation.noise)
        return replace(
            self,
            sums=sums,
            time_s=float(time_s[-1]),
            cells=self.cells + len(observations),
        )

    def information(self) -> Information:
        return self.sums.information()


@dataclass(frozen=True, slots=True)
class RunInput:
    """Inputs of the solve from one Run.

    pose : workpiece to tracker, about which the problem is linear
    """

    observations: Observations
    pose: RigidTransform
    noise: NoiseModel


@dataclass(frozen=True, slots=True)
class RunInformation:
    """Information of one Run, on its pose as well.

    data : over all parameters of the linearisation
    weak : precision of its pose that is in the data in addition to the cells
    """

    observations: Observations
    linearisation: Linearisation
    data: Information
    weak: Float64[np.ndarray, "6"] | None = None

    @property
    def noise(self) -> NoiseModel:
        return self.linearisation.noise

    @property
    def travel(self) -> Float64[np.ndarray, "n 3"]:
        """Unit vector of each cell in the beam frame, 0 at a standstill."""
        seen = self.observations
        turned = seen.direction @ self.linearisation.pose.rotation.T
        return np.einsum("nij,nj->ni", seen.beam_frame, turned)

    @property
    def own(self) -> OwnParameters:
        """Its pose, to be eliminated or restored. Raises Unidentifiable."""
        return OwnParameters.of(self.data, self.linearisation.machine_model.size)

    def replace_noise(self, noise: NoiseModel) -> RunInformation:
        """Recomputed from the observations, which takes as long as the first time."""
        linearisation = replace(self.linearisation, noise=noise)
        data = compute_information(self.observations, linearisation)
        return RunInformation(self.observations, linearisation, data)

    def restrict(self, effects: Sequence[Effect]) -> RunInformation:
        keep = self.linearisation.select_columns(effects)
        return RunInformation(
            self.observations,
            self.linearisation.restrict(effects),
            self.data.select(keep),
        )


def collect_information(
    runs: Sequence[RunInput], model: MachineModel
) -> tuple[RunInformation, ...]:
    """Linearised about the pose of each Run; one item for each."""
    found: list[RunInformation] = []
    for run in runs:
        about = linearise(run.observations, model, run.pose, run.noise)
        data = compute_information(run.observations, about)
        found.append(RunInformation(run.observations, about, data))
    return tuple(found)


def combine_runs(runs: Sequence[RunInformation]) -> Information:
    """Information of all Runs on the machine, poses integrated out.

    Raises Unidentifiable, with the number of the Run where there are several.
    """
    parts: list[Information] = []
    for number, run in enumerate(runs, start=1):
        try:
            parts.append(run.own.eliminate())
        except Unidentifiable as error:
            if len(runs) == 1:
                raise
            raise Unidentifiable(f"Run {number} of {len(runs)}: {error}") from error
    return add_information(parts)
