"""A model or result file as knowledge of the machine before a measurement.

Its catalogue effects are estimated together with the error motions, and the earlier
knowledge of their parameters is one more measurement: information adds. So a Run
corrects what it determines, the rest stays as it was, and the uncertainty of the tables
includes that of the effects. Nothing else of the earlier model is used: the error
motions are measured again, for a table that leans on the past would hide that the
machine has changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.special import chdtrc

from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError
from truepath.estimation.problem.information import (
    EXACTLY,
    Information,
    Posterior,
    invert_covariance,
)
from truepath.files.bundle.run import RunSummary, share_samples
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    CalibrationResult,
    decode_result,
)
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import CatalogueEffect, MachineModel

_LOOSE = 100.0
_MEASURED_SHARE = 0.05  # of a variance, removed by the Run: enough to contradict


@dataclass(frozen=True)
class PriorEffects:
    """Effects with their parameters and covariance, before a measurement.

    theta : (k,), covariance : (k, k), one effect after another
    """

    effects: tuple[CatalogueEffect, ...] = ()
    theta: Float64[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))
    covariance: Float64[np.ndarray, "k k"] = field(
        default_factory=lambda: np.zeros((0, 0))
    )

    def locate(self, model: MachineModel) -> slice:
        if not self.effects:
            return slice(0, 0)
        slices = [model.slices[effect.name] for effect in self.effects]
        return slice(slices[0].start, slices[-1].stop)

    def precision_matrix(self) -> Float64[np.ndarray, "k k"]:
        """Singular covariances are regularised, see `invert_covariance`."""
        return invert_covariance(self.covariance)

    def add_to(self, data: Information, model: MachineModel) -> Information:
        """Adds the earlier measurement to the information on a model.

        data : on the model's parameters, which may be followed by others
        """
        if not self.effects:
            return data
        part, precision = self.locate(model), self.precision_matrix()
        matrix, vector = data.matrix.copy(), data.vector.copy()
        pull = precision @ self.theta
        matrix[part, part] += precision
        vector[part] += pull
        square = data.square + float(self.theta @ pull)
        return replace(data, matrix=matrix, vector=vector, square=square)

    def inflate_covariance(self) -> PriorEffects:
        """The same effects with covariances of 100² times the size.

        For a Run that they were found in: it must not count twice.
        """
        return replace(self, covariance=_LOOSE**2 * self.covariance)

    def compute_chances(
        self, model: MachineModel, result: Posterior
    ) -> tuple[float | None, ...]:
        """Probability of at least this change if nothing has changed, by effect.

        result : of the model, with the Run. None where the Run does not determine the
            effect.
        """
        found: list[float | None] = []
        begin = 0
        for effect in self.effects:
            own = slice(begin, begin + len(effect.parameters))
            now, begin = model.slices[effect.name], own.stop
            before, after = self.covariance[own, own], result.covariance[now, now]
            moved = result.theta[now] - self.theta[own]
            found.append(_compute_chance(before, after, moved))
        return tuple(found)


def _compute_chance(
    before: Float64[np.ndarray, "k k"],
    after: Float64[np.ndarray, "k k"],
    moved: Float64[np.ndarray, " k"],
) -> float | None:
    """The covariance of the change is what the Run has removed."""
    scale = np.sqrt(np.diag(before) + EXACTLY**2)
    value, vector = np.linalg.eigh((before - after) / scale[:, None] / scale)
    is_measured = value > _MEASURED_SHARE
    if not is_measured.any():
        return None
    along = vector.T @ (moved / scale)
    square = float(np.sum(along[is_measured] ** 2 / value[is_measured]))
    return float(chdtrc(int(is_measured.sum()), square))


def extract_prior_effects(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> PriorEffects:
    effects = model.catalogue_effects
    numbers = np.arange(model.size)
    kept = np.concatenate(
        [np.zeros(0, np.int64), *(numbers[model.slices[e.name]] for e in effects)]
    )
    return PriorEffects(effects, theta[kept], covariance[np.ix_(kept, kept)])


@dataclass(frozen=True)
class PriorModel:
    """An earlier measurement's result for a machine.

    source : its file, or its identifier in the service; sha256 : of the file
    """

    result: CalibrationResult
    source: str
    sha256: str

    @property
    def version(self) -> int:
        return self.result.version

    @property
    def runs(self) -> tuple[dict[str, Any], ...]:
        """Source Runs of the result, each with its name and digest."""
        provenance = self.result.provenance
        own = {
            "name": provenance.get("run", ""),
            "input_sha256": provenance.get("input_sha256", ""),
        }
        return tuple(provenance.get("runs") or ((own,) if own["input_sha256"] else ()))

    def uses_any_run(self, runs: Sequence[RunSummary]) -> bool:
        """True if one of these Runs, or a part of one, was a source of the result."""
        return any(
            own["input_sha256"] == run.digest
            or share_samples(own.get("sketch", ""), run.sketch)
            for own in self.runs
            for run in runs
        )

    def select_effects(
        self, machine: Machine, runs: Sequence[RunSummary] = ()
    ) -> PriorEffects:
        """Known effects for the analysis of a machine.

        runs : to be analysed; if one of them is a source of the result, its numbers
            count as unknown, for no Run counts twice

        Raises BundleError if it is of another machine or of another target, NotUsable
        if its numbers are not to be used.
        """
        self._require_same(machine)
        own = self.result
        known = extract_prior_effects(own.model, own.theta, own.covariance)
        if self.uses_any_run(runs):
            return known.inflate_covariance()
        own.verdict.require_usable(self.source)
        return known

    def require_comparable(self, machine: Machine) -> None:
        """Raise unless the result may be compared with a measurement of a machine.

        BundleError if it is of another machine or of another target, NotUsable if it is
        not to be used.
        """
        self._require_same(machine)
        self.result.verdict.require_usable(self.source)

    def assess_use(self) -> Verdict:
        """Verdict for results that use this model: doubtful unless it is usable."""
        if self.result.verdict.state == "usable":
            return Verdict()
        return Verdict((Reason("model-in-use", "doubtful", {"model": self.source}),))

    def _require_same(self, machine: Machine) -> None:
        own = self.result.machine
        for key, mine, theirs in (
            ("kinematic_chain", own.chain, machine.chain),
            ("axes", _travels(own), _travels(machine)),
        ):
            if mine != theirs:
                raise BundleError(
                    f"machine.{key}: {mine}, but {theirs} in the measurement",
                    file=self.source,
                    remedy="give a model of the measured machine",
                )
        same = {(t.on, t.offset_mm) for t in machine.targets} <= {
            (t.on, t.offset_mm) for t in own.targets
        }
        if not same and not self.result.model.knows_all_motions:
            raise BundleError(
                "holds for its own target offset alone: it does not have all motions",
                file=self.source,
                remedy="give a model made with the measured target, or with several",
            )


def read_prior_model(file: str | Path, source: str = "") -> PriorModel:
    """Read a model or result file. Raises BundleError.

    source : name of the model in results; its file if left out
    """
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    result = decode_result(data, file=str(file))
    return PriorModel(result, source or str(file), hashlib.sha256(data).hexdigest())


def _travels(machine: Machine) -> str:
    return ", ".join(f"{a.name} {a.low:g} to {a.high:g}" for a in machine.axes)
