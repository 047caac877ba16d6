"""Outcomes of many worlds in a few numbers, and as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from discovery_score import NOTHING, UNNAMED, Outcome
from document import table

_BINS = (8.0, 12.0, 20.0, 40.0, 80.0, np.inf)
_MARKED = ("single", "pair", "triple", "clean", "off-catalogue", "tenth")
_HARD = {
    "tenth": "a tenth of the size",
    "tenfold": "ten times the size",
    "rough-stream": "beam breaks, strays, lost frames, holds",
    "poor-hall": "noise doubled, a third of it slow",
    "standstill": "points instead of lines; one in ten clean",
}
_WITHIN = 2.0  # an expanded uncertainty


@dataclass(frozen=True)
class Summary:
    """Shares over worlds; `nan` where there is no such world.

    singles_right, pairs_right, triples_right : all effects named and no other
    tenth_wrong : of effects of a tenth of the usual size, those given a wrong name
    false_alarms : of clean worlds in which anything was said
    misnamed : of worlds whose effect is in no catalogue and was given a name
    within : of parameters of rightly named effects, off by at most 2 u
    closed : of worlds with all effects named, those whose gap over the noise floor is
        at most what clean worlds show, mean + 3 standard deviations
    """

    singles_right: float
    pairs_right: float
    triples_right: float
    tenth_wrong: float
    false_alarms: float
    misnamed: float
    described: float
    within: float
    closed: float


def summarise(outcomes: Sequence[Outcome]) -> Summary:
    kinds = {k: [o for o in outcomes if o.kind == k] for k in _kinds(outcomes)}
    off, clean = kinds.get("off-catalogue", []), kinds.get("clean", [])
    named = [o for o in outcomes if o.right and o.kind in ("single", "pair")]
    deviation = [v for o in outcomes for v in o.deviation.values()]
    return Summary(
        _share([o.right for o in kinds.get("single", [])]),
        _share([o.right for o in kinds.get("pair", [])]),
        _share([o.right for o in kinds.get("triple", [])]),
        _share([bool(o.wrong) for o in kinds.get("tenth", [])]),
        _share([bool(o.said) or o.describes for o in clean]),
        _share([bool(o.said) for o in off]),
        _share([o.describes and not o.said for o in off]),
        _share([abs(v) <= _WITHIN for v in deviation]),
        _share([o.closed <= _largest_clean_gap(clean) for o in named]),
    )


def list_missed_marks(got: Summary) -> list[str]:
    """Return what does not reach its mark, one statement each."""
    return [
        f"{title}: {_percent(value)}, asked for {_range(low, high)}"
        for title, value, low, high in _list_marks(got)
        if not low <= value <= high
    ]


def marks_table(outcomes: Sequence[Outcome]) -> str:
    got = summarise(outcomes)
    count = Counter(o.kind for o in outcomes)
    named = sum(o.right for o in outcomes if o.kind in ("single", "pair"))
    of = [
        *(count[k] for k in _MARKED),
        sum(len(o.deviation) for o in outcomes),
        named,
    ]
    rows = [
        [title, number, _percent(value), _range(low, high)]
        for (title, value, low, high), number in zip(_list_marks(got), of, strict=True)
    ]
    described = ["off-catalogue effects described", count["off-catalogue"]]
    rows.insert(len(_MARKED) - 1, [*described, _percent(got.described), ""])
    return table(["what", "of", "found", "mark"], rows)


def hard_table(outcomes: Sequence[Outcome]) -> str:
    rows = []
    for kind, title in _HARD.items():
        each = [o for o in outcomes if o.kind == kind]
        silent = [not o.said for o in each]
        rows.append(
            [
                title,
                len(each),
                _percent(_share([o.right for o in each])),
                _percent(_share(silent)),
                _percent(_share([bool(o.wrong) for o in each])),
            ]
        )
    return table(["single effects", "worlds", "named right", "no name", "wrong"], rows)


def confusion_table(outcomes: Sequence[Outcome]) -> str:
    """Return what was said of each hidden effect on its own, in counts."""
    alone = [o for o in outcomes if o.kind in ("single", "clean", "off-catalogue")]
    counts: dict[str, Counter[str]] = {}
    for o in alone:
        truth = _name(o.truth[0]) if o.truth else "(clean)"
        counts.setdefault(truth, Counter())[_answer(o)] += 1
    answers = sorted({a for c in counts.values() for a in c})
    rows = [
        [truth, *[c[a] or "" for a in answers]] for truth, c in sorted(counts.items())
    ]
    return table(["hidden \\ said", *answers], rows)


def size_table(outcomes: Sequence[Outcome]) -> str:
    """Return the share found against the ideal test's signal-to-noise ratio."""
    rows = []
    for low, high in pairwise(_BINS):
        found = [
            bool(m)
            for o in outcomes
            if o.catalogued
            for s, m in zip(o.signal_to_noise, o.matched, strict=True)
            if low <= s < high
        ]
        name = f"{low:.0f} to {high:.0f}" if np.isfinite(high) else f"over {low:.0f}"
        rows.append([name, len(found), _percent(_share(found))])
    return table(["size in units of noise", "effects", "named"], rows)


def parameter_table(outcomes: Sequence[Outcome]) -> str:
    """Return how far parameters are off, in units of their uncertainty."""
    by_name: dict[str, list[float]] = {}
    for o in outcomes:
        for name, value in o.deviation.items():
            by_name.setdefault(name, []).append(value)
    rows = [
        [
            name,
            len(values),
            f"{np.mean(values):+.2f}",
            f"{np.sqrt(np.mean(np.square(values))):.2f}",
            _percent(_share([abs(v) <= _WITHIN for v in values])),
        ]
        for name, values in sorted(by_name.items())
    ]
    return table(["parameter", "of", "mean / u", "rms / u", "within 2 u"], rows)


def _answer(o: Outcome) -> str:
    if o.right and any(o.matched):
        return _name(o.truth[0])
    if o.said:
        return _name((o.wrong or o.said)[0])
    return UNNAMED if o.describes else NOTHING


def _kinds(outcomes: Sequence[Outcome]) -> set[str]:
    return {o.kind for o in outcomes}


def _name(label: str) -> str:
    return label.split()[0]


def _share(true: Sequence[bool]) -> float:
    return float(np.mean(true)) if len(true) else float("nan")


def _percent(share: float) -> str:
    return "–" if np.isnan(share) else f"{100.0 * share:.1f} %"


def _list_marks(got: Summary) -> list[tuple[str, float, float, float]]:
    """Return title, share, and the range in which it has to be."""
    return [
        ("single effects named right", got.singles_right, 0.97, 1.0),
        ("pairs, both named right", got.pairs_right, 0.90, 1.0),
        ("triples, all named right", got.triples_right, 0.85, 1.0),
        ("clean worlds with a false alarm", got.false_alarms, 0.0, 0.01),
        ("off-catalogue effects given a name", got.misnamed, 0.0, 0.05),
        ("a tenth of the usual size, wrong names", got.tenth_wrong, 0.0, 0.02),
        ("parameters within 2 u", got.within, 0.90, 0.99),
        ("gap where named no larger than in clean worlds", got.closed, 0.99, 1.0),
    ]


def _largest_clean_gap(clean: Sequence[Outcome]) -> float:
    """Return the largest gap over noise floor that noise alone explains.

    Held-out lines are few, so that the ratio scatters where nothing is missing: clean
    worlds show by how much.
    """
    ratio = np.array([o.closed for o in clean])
    return float(ratio.mean() + 3.0 * ratio.std()) if len(ratio) else np.inf


def _range(low: float, high: float) -> str:
    if low == 0.0:
        return f"at most {100.0 * high:.0f} %"
    if high == 1.0:
        return f"at least {100.0 * low:.0f} %"
    return f"{100.0 * low:.0f} to {100.0 * high:.0f} %"
