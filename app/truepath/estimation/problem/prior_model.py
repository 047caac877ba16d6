"""A model or result file as knowledge of the machine before a measurement."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError
from truepath.estimation.problem.prior_effects import (
    PriorEffects,
    extract_prior_effects,
)
from truepath.files.bundle.run import RunSummary, share_samples
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    CalibrationResult,
    decode_result,
)
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.kinematics.machine.machine import Machine


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
        """Version number of the result's model."""
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
        for field, mine, theirs in (
            ("kinematic_chain", own.chain, machine.chain),
            ("axes", _travels(own), _travels(machine)),
        ):
            if mine != theirs:
                raise BundleError(
                    f"machine.{field}: {mine}, but {theirs} in the measurement",
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
