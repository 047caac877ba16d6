"""The certificate as one HTML file that needs no other, for screen and paper."""

from __future__ import annotations

from collections.abc import Callable

from truepath.answers.certificate.closing_sections import (
    describe_compensation,
    describe_effects,
    describe_provenance,
    describe_signatures,
    describe_verification,
)
from truepath.answers.certificate.identity_sections import (
    describe_conformity,
    describe_heading,
    describe_identity,
    describe_verdict,
)
from truepath.answers.certificate.issue import Certificate
from truepath.answers.certificate.language import Language, load_language
from truepath.answers.certificate.limits import describe_limits
from truepath.answers.certificate.measurement_sections import (
    describe_measurement,
    describe_setup,
)
from truepath.answers.certificate.result_sections import (
    describe_brief,
    describe_budget,
    describe_curves,
    describe_positioning,
    describe_single,
    describe_tables,
    describe_volume,
)
from truepath.answers.shown.page import View, render_page

_VIEWS: dict[str, Callable[[Certificate, Language], View]] = {
    "heading": describe_heading,
    "verdict": describe_verdict,
    "conformity": describe_conformity,
    "identity": describe_identity,
    "brief": describe_brief,
    "measurement": describe_measurement,
    "setup": describe_setup,
    "volume": describe_volume,
    "budget": describe_budget,
    "single": describe_single,
    "limits": describe_limits,
    "iso": describe_positioning,
    "effects": describe_effects,
    "verification": describe_verification,
    "compensation": describe_compensation,
    "curves": describe_curves,
    "tables": describe_tables,
    "provenance": describe_provenance,
    "signature": describe_signatures,
}


def render_certificate(
    certificate: Certificate, *, accept_verdict: bool = False
) -> str:
    """One file of HTML.

    accept_verdict : also of a result that is not to be used; the page says so

    Raises NotUsable.
    """
    if not accept_verdict:
        verdict = certificate.found.result.verdict
        verdict.require_usable(f"{certificate.found.name}: the result")
        if (left := certificate.left_verdict) and certificate.left:
            left.require_usable(f"{certificate.left.name}: the result as left")
    language = load_language(certificate.language)
    views = {name: view(certificate, language) for name, view in _VIEWS.items()}
    return render_page(
        "certificate.html",
        {
            **views,
            "language": language.code,
            "say": language.say,
            "date": certificate.issued,
        },
    )
