"""What a measurement cannot tell stands in a German certificate in German."""

import inspect
import re

import pytest
from tests.sentences_of_the_service import ENGLISH, list_unobservable

from truepath.answers.certificate.language import load_language
from truepath.answers.certificate.limits import (
    say_poorly_observable,
    say_unobservable,
)
from truepath.estimation.problem import observability
from truepath.estimation.problem.observability import PoorlyObservableShape

GERMAN, BRITISH = load_language("de"), load_language("en")
MERGED = (
    "ECZ (roll of Z) cannot be told from EXZ and EYZ with one tool length; a second "
    "target at least 180 mm to the side, in X or Y, separates them (to 3.4 µrad, "
    "k = 2, on the same path)"
)


def list_forms():
    """Yield every form of a shape, as the code that names it has them."""
    source = inspect.getsource(observability.describe_form)
    shapes = set(re.findall(r"\ban? (?:slope|bow|wave)\b|\ban S\b", source))
    assert len(shapes) == 4
    for shape in shapes:
        for what in ("error", "turning"):
            yield f"{shape} of the {what} along X"
    yield "the angle"


def list_poor():
    for form in list_forms():
        for symbols in (("EXX",), ("EXX", "C0Y"), ("EXX", "EYX", "EZX", "EAX", "EBX")):
            yield str(PoorlyObservableShape(symbols, 0.73, 2.4e-3, form))


@pytest.mark.parametrize(
    ("say", "texts"),
    [
        (say_unobservable, sorted(set(list_unobservable()))),
        (say_poorly_observable, sorted(set(list_poor()))),
    ],
)
def test_no_statement_of_a_limit_stays_english_in_a_german_certificate(say, texts):
    assert len(texts) > 10
    for text in texts:
        said = say(text, GERMAN)
        left = set(re.findall(r"\w+", said.lower())) & (ENGLISH | {"turning", "along"})
        assert not left, f"{text!r} is said as {said!r}"
        assert say(text, BRITISH) == text


def test_numbers_of_a_statement_stand_in_its_german_words():
    said = say_unobservable(MERGED, GERMAN)
    assert said.startswith(
        "ECZ (Rollen von Z) ist mit dem Gemessenen nicht von EXZ und"
    )
    assert "mindestens 180 mm seitlich" in said
    assert "auf 3,4 µrad bekannt (k = 2)" in said
    shape = PoorlyObservableShape(
        ("EXX", "C0Y"), 0.73, 2.4e-3, "an S of the error along X"
    )
    said = say_poorly_observable(str(shape), GERMAN)
    assert said.startswith(
        "EXX zusammen mit C0Y: ein S-förmiger Verlauf der Abweichung"
    )
    assert "73 % dessen" in said
    assert "2,4 µm (k = 1)" in said


@pytest.mark.parametrize("say", [say_unobservable, say_poorly_observable])
def test_a_statement_of_another_version_stands_as_it_is(say):
    assert say("EXX is unsure", GERMAN) == "EXX is unsure"
