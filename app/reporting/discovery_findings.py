"""The sections of the report that tell what is missing, with a name and without."""

from __future__ import annotations

from app.discovery.discover import Discovery, Finding
from app.kinematics.effects.catalogue import Described
from app.reporting.html_parts import callout, escape, facts
from app.results.discovery_wording import others, title
from app.results.model_difference import in_words
from app.results.model_file import NextModel
from app.results.numbers_as_text import plain


def split(found: Discovery) -> tuple[list[Finding], list[Finding]]:
    """Return the effects that have a name, and what has none."""
    named = [f for f in found.findings if f.structure is None]
    return named, [f for f in found.findings if f.structure is not None]


def findings_section(found: Discovery, model: NextModel) -> tuple[str, ...]:
    """Return heading and content: each effect with numbers, cause and remedy."""
    named, unnamed = split(found)
    if not named:
        text = (
            f"None of the {found.compared} effects that were looked for explains this "
            "measurement better than noise does."
        )
        if unnamed:
            text = (
                "Something is there, and none of the causes in the catalogue explains "
                "it: see the structure without a name."
            )
        return ("Which effects are missing", callout(text))
    return (
        "Which effects are missing",
        *(_finding(f, found, model) for f in named),
    )


def _finding(finding: Finding, found: Discovery, model: NextModel) -> str:
    words, evidence = finding.family.signature, finding.evidence
    numbers = [
        in_words(name, m.value, m.uncertainty) for name, m in finding.parameters.items()
    ]
    part = (
        "becomes part of the machine's model"
        if model.extended.holds(finding)
        else "belongs to this measurement: taken out of the machine's numbers"
    )
    pairs = [
        ("Cause", escape(words.cause)),
        ("Looks like", escape(words.looks_like)),
        ("What to do", escape(words.remedy)),
        (
            "Evidence",
            f"closes {100 * evidence.share:.0f} % of the gap; log Bayes factor "
            f"{plain(evidence.log_bayes)} after the price of looking at "
            f"{found.compared} effects; lines not seen are foretold better by "
            f"{plain(evidence.held_out)} (log score)",
        ),
        ("May also be", escape(others(finding))),
        ("In the model", part),
    ]
    return (
        f'<div class="finding"><h3>{escape(title(finding.candidate))}</h3>'
        f'<p class="numbers">{escape("; ".join(numbers))} (k = 2)</p>'
        f"{facts(pairs)}</div>"
    )


def unnamed_section(found: Discovery) -> tuple[str, ...]:
    """Return heading and content: structure without a name, described."""
    _, unnamed = split(found)
    if not unnamed:
        return (
            "Structure without a name",
            "<p>None: what is left does not depend on time, on an axis or on two axes "
            "together more than noise would.</p>",
        )
    items = "".join(
        f"<li>{_described(f.structure, f)}</li>" for f in unnamed if f.structure
    )
    return (
        "Structure without a name",
        "<p>No effect of the catalogue explains it, and none is forced on it.</p>"
        f"<ul>{items}</ul>",
    )


def _described(family: Described, finding: Finding) -> str:
    text = family.told(finding.candidate, finding.parameters)
    words = family.signature
    return escape(
        f"{text[0].upper()}{text[1:]}; it closes {100 * finding.evidence.share:.0f} % "
        f"of the gap. {words.cause} {words.remedy}"
    )
