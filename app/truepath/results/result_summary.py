"""All content of a result, gathered once for the result file and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.stream.left_out import LeftOut
from truepath.estimation.checks.robust_estimate import CheckedEstimate
from truepath.estimation.checks.run_segments import SetupShift
from truepath.estimation.problem.prior_model import PriorModel
from truepath.estimation.solve.batch import Estimate, RunEstimate
from truepath.estimation.solve.budget import Contributions, UncertaintyBudget
from truepath.estimation.solve.known_scale import KnownScale, settle_scale
from truepath.files.bundle.run import RunSummary
from truepath.files.earlier.verdict import Verdict
from truepath.files.environment import state_length_ppm
from truepath.files.units import PER_PPM, UM_PER_MM
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.planning.grade import Grade
from truepath.results.error_tables import ErrorTables, build_error_tables
from truepath.results.monte_carlo_results import TrialResults
from truepath.results.result_assessment import (
    assess,
    assess_gain,
    assess_program,
    assess_scale,
)
from truepath.results.volumetric_error import (
    BothDirections,
    VolumetricError,
    compute_both_directions,
    compute_volumetric_error,
)


@dataclass(frozen=True, slots=True)
class Provenance:
    """Which program computed a result from which Runs, when and how.

    model : whose effects are estimated together with the error motions, if one was
        given
    """

    runs: tuple[RunSummary, ...]
    software_version: str
    created: datetime
    model: PriorModel | None = None

    @property
    def repeats_model(self) -> bool:
        """Whether the model was made from a Run that is analysed now.

        Then the effects are taken from it and their numbers are not.
        """
        return self.model is not None and self.model.uses_any_run(self.runs)

    def assess_model(self) -> Verdict:
        """Reasons from use of the model's numbers; empty where not used."""
        if self.model is None or self.repeats_model:
            return Verdict()
        return self.model.assess_use()

    def state_length_scale(
        self, tracker: TrackerNoise, *, has_known: bool
    ) -> float | None:
        """Standard uncertainty that all lengths have in common, of 1.

        Of several Runs the largest: one tracker measures them all. None where there are
        none.

        has_known : of Runs with known lengths, or of those without
        """
        ppm = [
            state_length_ppm(run.refraction, tracker.range_ppm)
            for run in self.runs
            if bool(run.known_lengths) == has_known
        ]
        return PER_PPM * max(ppm) if ppm else None


@dataclass(frozen=True, slots=True)
class LineResiduals:
    """Residuals by row of the path or points: root mean square of one component.

    row : (m,), cells : (m,), rms_um : (m,)
    """

    row: Int64[np.ndarray, " m"]
    cells: Int64[np.ndarray, " m"]
    rms_um: Float64[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Standard deviations along and across the beam at the mean distance.

    stated_um : (2,) of one sample, as the machine file states it
    white_um : (2,) of one sample, as found; ou_um : (2,) of the correlated part
    along_travel_um : of a cell, beyond phase and speed; None where not used
    """

    distance_mm: float
    stated_um: Float64[np.ndarray, "2"]
    white_um: Float64[np.ndarray, "2"]
    ou_um: Float64[np.ndarray, "2"]
    ou_time_s: float
    along_travel_um: float | None


@dataclass(frozen=True, slots=True)
class RunFindings:
    """Findings on one Run.

    number : of the Run in the estimate, from 0
    part : of the Run given, from 1, where it was split at a shift of the set-up; else 0
    """

    number: int
    summary: RunSummary
    estimate: RunEstimate
    by_line: LineResiduals
    noise: NoiseFound
    part: int = 0


@dataclass(frozen=True, slots=True)
class Findings:
    """An estimate and what follows from it.

    runs : the Runs that it was made from, in the order given
    trials : simulated trials of it, if they were run
    grade : of the set-up before the measurement, if requested
    verdict : whether the result may be used
    left_out : of each Run given, what was not used; setup_shifts : shifts of the set-up
    contributions : of each Run given, if requested
    budget : share of each source of uncertainty, if requested
    both_directions : the volumetric error with lost motion, where that is determined
    length_scale_ppm : standard uncertainty that all lengths have in common, of air and
        tracker, which the covariance of the estimate contains
    known_scale : scale by known lengths, where there were some
    """

    estimate: Estimate
    provenance: Provenance
    tables: ErrorTables
    volumetric: VolumetricError
    runs: tuple[RunFindings, ...]
    trials: TrialResults | None = None
    grade: Grade | None = None
    verdict: Verdict = field(default_factory=Verdict)
    left_out: tuple[tuple[LeftOut, ...], ...] = ()
    setup_shifts: tuple[SetupShift, ...] = ()
    contributions: Contributions | None = None
    budget: UncertaintyBudget | None = None
    both_directions: BothDirections | None = None
    length_scale_ppm: float = 0.0
    known_scale: KnownScale | None = None

    @property
    def main(self) -> RunFindings:
        """The Run with the most used samples."""
        return self.runs[self.estimate.main]

    def get_uncertainty_without_run_um(self, run: RunFindings) -> float | None:
        """Uncertainty without this Run; None where the others determine too little."""
        if self.contributions is None or not self.contributions.without_mm:
            return None
        number = [one.digest for one in self.provenance.runs].index(run.summary.digest)
        without_mm = self.contributions.without_mm[number]
        return UM_PER_MM * without_mm if np.isfinite(without_mm) else None


def state_checked_findings(
    checked: CheckedEstimate,
    provenance: Provenance,
    trials: TrialResults | None = None,
    grade: Grade | None = None,
) -> Findings:
    """With the verdict, rejected data and shifts of the set-up."""
    found = state_findings(checked.estimate, provenance, trials, grade, checked.given)
    own = assess(checked, [run.name for run in provenance.runs])
    return replace(
        found,
        verdict=Verdict.merge(
            [
                own,
                provenance.assess_model(),
                assess_gain(found.volumetric),
                assess_scale(found.estimate, found.known_scale),
                assess_program(found.estimate.model.machine, found.volumetric),
            ]
        ),
        left_out=checked.left_out,
        setup_shifts=checked.setup_shifts,
    )


def state_findings(
    estimate: Estimate,
    provenance: Provenance,
    trials: TrialResults | None = None,
    grade: Grade | None = None,
    given: Sequence[int] | None = None,
) -> Findings:
    """Findings of an estimate, without a verdict.

    given : of each Run of the estimate, which of the provenance it is of; as many, in
        order, if left out
    """
    sources = list(range(len(estimate.runs)) if given is None else given)
    estimate, scale, known_scale = apply_length_scale(estimate, provenance, sources)
    length_scale_ppm = scale / PER_PPM
    return Findings(
        estimate,
        provenance,
        build_error_tables(estimate, estimate.measured),
        compute_volumetric_error(estimate, length_scale_ppm),
        tuple(
            RunFindings(
                number,
                provenance.runs[source],
                run,
                group_residuals(run, across_only=estimate.perpendicular_only),
                state_noise(run),
                sources[:number].count(source) + 1 if sources.count(source) > 1 else 0,
            )
            for number, (source, run) in enumerate(
                zip(sources, estimate.runs, strict=True)
            )
        ),
        trials,
        grade,
        both_directions=compute_both_directions(estimate, length_scale_ppm),
        length_scale_ppm=length_scale_ppm,
        known_scale=known_scale,
    )


def apply_length_scale(
    estimate: Estimate, provenance: Provenance, sources: Sequence[int]
) -> tuple[Estimate, float, KnownScale | None]:
    """An estimate with the scale of air, tracker and known lengths in it.

    Known lengths determine the scale of their own Runs alone: air of another hour is
    other air. Of a joint estimate it is unknown how much of it came from which Run: one
    without known lengths may deviate by as much as was found.

    sources : of each Run of the estimate, which of the provenance it is of
    """
    tracker = estimate.model.machine.tracker
    known = [
        provenance.runs[source].known_lengths if source not in sources[:number] else ()
        for number, source in enumerate(sources)
    ]
    settled = provenance.state_length_scale(tracker, has_known=True)
    other = provenance.state_length_scale(tracker, has_known=False)
    if settled is None or other is None:
        return settle_scale(estimate, settled or other or 0.0, known)
    estimate, left, found = settle_scale(estimate, settled, known)
    apart = max(other, settled, abs(found.off) if found else 0.0)
    return estimate.widen_by_scale(apart), float(np.hypot(left, apart)), found


def group_residuals(run: RunEstimate, *, across_only: bool) -> LineResiduals:
    """RMS residual of each row, counted as `Residuals.rms_mm` does.

    across_only : only components across the travel were used
    """
    residuals = run.residuals
    if across_only:
        square = residuals.across_mm**2 / 3.0
    else:
        square = np.mean(residuals.residual_mm**2, axis=1)
    row, place, cells = np.unique(
        residuals.row, return_inverse=True, return_counts=True
    )
    mean = np.bincount(place, square, len(row)) / cells
    return LineResiduals(row, cells, UM_PER_MM * np.sqrt(mean))


def state_noise(run: RunEstimate) -> NoiseFound:
    """At the mean distance, in µm."""
    noise = run.noise
    stated = UM_PER_MM * run.tracker.sigma_mm(np.array([run.distance_mm]))[0]
    along = UM_PER_MM * noise.along_sigma_mm
    return NoiseFound(
        run.distance_mm,
        stated,
        stated * np.array(noise.white),
        stated * np.array(noise.ou_along_and_across),
        noise.ou_time_s,
        along if np.isfinite(along) else None,
    )
