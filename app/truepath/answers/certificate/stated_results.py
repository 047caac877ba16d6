"""The main numbers of a certificate, stated once: for its pages and its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from truepath.answers.verification.conformity import Conformity, decide_conformity
from truepath.documents.file_model import as_object

if TYPE_CHECKING:  # a service reads the records without what computes
    from truepath.answers.certificate.issue import Certificate

State = Literal[
    "before",
    "before_both_directions",
    "after_expected",
    "after_left",
    "after_left_both_directions",
]
_K = 2.0


@dataclass(frozen=True, slots=True)
class Expanded:
    """A number in µm with its expanded uncertainty, and the coverage factor of that."""

    value_um: float
    expanded_uncertainty_um: float
    coverage_factor: float = _K


@dataclass(frozen=True, slots=True)
class StatedError:
    """Length of the volumetric error of the machine in one state."""

    state: State
    mean: Expanded
    p95: Expanded
    largest: Expanded


@dataclass(frozen=True, slots=True)
class StatedConformity:
    """A decision by ISO 14253-1.

    of : `before` and `after_left`, 95 % of the volume against the tolerance of the
        machine; `verification`, the deciding place against its own tolerance
    places : of the verification; else None
    """

    of: Literal["before", "after_left", "verification"]
    conformity: Conformity
    tolerance_um: float
    size: Expanded
    places: int | None = None


@dataclass(frozen=True, slots=True)
class StatedResults:
    """Main numbers of a certificate."""

    volumetric_error: tuple[StatedError, ...]
    conformity: tuple[StatedConformity, ...]


def list_main_results(certificate: Certificate) -> StatedResults:
    """From the files that a certificate is made of."""
    errors = tuple(list_volumetric_errors(certificate))
    return StatedResults(errors, tuple(_list_conformity(certificate, errors)))


def list_volumetric_errors(certificate: Certificate) -> Iterator[StatedError]:
    """As found, expected after compensation, and as left."""
    found = certificate.found.content["volumetric_error"]
    yield _make_error("before", found["before"])
    if both := found.get("both_directions"):
        yield _make_error("before_both_directions", both)
    yield _make_error("after_expected", found["after_expected"])
    if certificate.left is not None:
        left = certificate.left.content["volumetric_error"]
        yield _make_error("after_left", left["before"])
        if both := left.get("both_directions"):
            yield _make_error("after_left_both_directions", both)


def _make_error(state: State, spread: Mapping[str, Mapping[str, float]]) -> StatedError:
    figures = (
        Expanded(one["value_um"], _K * one["uncertainty_um"])
        for one in (spread["mean"], spread["p95"], spread["largest"])
    )
    return StatedError(state, *figures)


def _list_conformity(
    certificate: Certificate, errors: tuple[StatedError, ...]
) -> Iterator[StatedConformity]:
    """None of a result that is not to be used, or of a verification of another."""
    tolerance_um = certificate.tolerance_um
    verdicts = {
        "before": certificate.found.result.verdict,
        "after_left": certificate.left_verdict,
    }
    for one in errors:
        verdict = verdicts.get(one.state)
        if tolerance_um is None or verdict is None or verdict.state == "not-usable":
            continue
        size = one.p95
        decision = decide_conformity(
            size.value_um, size.expanded_uncertainty_um, tolerance_um
        )
        of = "before" if one.state == "before" else "after_left"
        yield StatedConformity(of, decision, tolerance_um, size)
    verification = certificate.verification
    if verification is not None and not verification.is_of_another(certificate.found):
        measured = as_object(
            as_object(verification.content.get("conformity")).get("measured")
        )
        if measured:
            yield StatedConformity(
                "verification",
                Conformity(measured["conformity"]),
                measured["tolerance_um"],
                Expanded(
                    measured["length_um"],
                    measured["expanded_uncertainty_um"],
                    measured["coverage_factor"],
                ),
                len(verification.content["places"]["row"]),
            )
