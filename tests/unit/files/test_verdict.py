"""Reasons as sentences, as JSON and back; the state that they ask for together."""

import json
from dataclasses import asdict
from string import Formatter

import pytest

from truepath.errors import NotUsable
from truepath.files.earlier import verdict as verdicts
from truepath.files.earlier.verdict import Reason, Verdict

ASIDE = {"samples": 42, "line": 7, "from_s": 61.25, "to_s": 61.33, "distance_um": 5012}
LEFT_OUT = Reason("samples-left-out", "usable", ASIDE)
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


def test_a_reason_is_a_sentence_with_its_numbers_units_and_run_of_several():
    assert str(LEFT_OUT) == (
        "42 samples of line 8, from 61.2 s to 61.3 s on the tracker's clock, are left "
        "out: they lie 5012.0 µm aside from the others."
    )
    assert "3.50 times that of noise; up to 1.30" in str(BEYOND)
    reason = Reason(LEFT_OUT.kind, "usable", LEFT_OUT.values, "monday")
    assert str(reason) == f"Run monday: {LEFT_OUT}"


def test_the_state_is_the_worst_that_any_reason_asks_for_and_the_worst_is_refused():
    doubtful = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
    assert Verdict().state == "usable"
    assert Verdict((LEFT_OUT,)).state == "usable"
    assert Verdict((LEFT_OUT, doubtful)).state == "doubtful"
    both = Verdict.merge([Verdict((BEYOND,)), Verdict((LEFT_OUT, doubtful))])
    assert (both.state, both.reasons) == ("not-usable", (BEYOND, LEFT_OUT, doubtful))
    Verdict((LEFT_OUT, doubtful)).require_usable("the result")
    with pytest.raises(NotUsable) as caught:
        Verdict((LEFT_OUT, BEYOND)).require_usable("model.json")
    assert str(caught.value) == f"model.json is not to be used: {BEYOND}"


def test_a_verdict_is_restored_from_its_file():
    verdict = Verdict((LEFT_OUT, BEYOND))
    content = json.loads(json.dumps(verdicts.verdict_json(verdict)))
    assert content["state"] == "not-usable"
    assert content["reasons"] == [str(LEFT_OUT), str(BEYOND)]
    assert verdicts.verdict_from_json(content) == verdict


@pytest.mark.parametrize(
    ("state", "texts", "details"),
    [
        ("not-usable", ["Line 3 is odd."], []),  # sentences alone
        ("not-usable", [], []),
        ("not-usable", [str(LEFT_OUT)], [asdict(LEFT_OUT)]),  # which does not carry it
        ("doubtful", ["New."], [asdict(Reason("of-a-later-version", "doubtful", {}))]),
        ("doubtful", ["Short."], [asdict(Reason("loop-open", "doubtful", {}))]),
        ("not-usable", ["Odd."], None),
        ("not-usable", ["Odd."], 7),
        ("not-usable", ["Odd."], ["Line 3 is odd."]),
        ("not-usable", ["Odd."], [{"kind": "loop-open"}]),
        ("not-usable", ["Odd."], [asdict(LEFT_OUT) | {"kind": 3, "state": "fine"}]),
        ("not-usable", ["Odd."], [asdict(LEFT_OUT) | {"values": [1.0]}]),
    ],
)
def test_a_state_stands_whatever_its_reasons_are(state, texts, details):
    restored = verdicts.verdict_from_json(
        {"state": state, "reasons": texts, "details": details}
    )
    assert restored.state == state
    said = [str(reason) for reason in restored.reasons]
    assert said == (texts or ["The file states no reason."])
    assert restored.objection.endswith(said[0])


def test_the_worst_comes_first_and_what_to_do_is_said_once():
    first, *others = Verdict((LEFT_OUT, LEFT_OUT, BEYOND)).rank()
    assert first == (BEYOND, BEYOND.remedy)
    assert others == [(LEFT_OUT, LEFT_OUT.remedy), (LEFT_OUT, "")]


@pytest.mark.parametrize("kind", sorted(verdicts.SENTENCES))
def test_every_kind_is_a_sentence_with_numbers_and_a_remedy(kind):
    text, remedy = verdicts.SENTENCES[kind]
    names = [name for _, name, _, _ in Formatter().parse(text) if name]
    assert names
    assert text.endswith(".") or kind == "stated"
    assert not remedy or remedy.endswith(".")


def test_sentences_count_rows_from_1_as_programs_do():
    stated = {"lines-without-data": {"lines": "0, 9, …"}}
    stated["path-not-whole"] = {"first": 1, "last": 23, "lines": 29}
    said = [str(Reason(kind, "usable", values)) for kind, values in stated.items()]
    assert "on lines 1, 10, …:" in said[0]
    assert said[1].endswith("shows lines 2 to 24; the last of the path is 30.")
