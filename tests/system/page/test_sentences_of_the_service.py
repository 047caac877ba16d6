"""What the service says in English is said in every language of the page.

The sentences are collected where the service has them: one that is added there and not
in the scripts of the page is found here.
"""

import ast
import inspect
import math
import re
from collections.abc import Iterator
from itertools import product

import pytest

from sentences_of_the_service import ENGLISH, list_unobservable
from truepath.answers import temperature
from truepath.catalogue.transitions import State, Verb, apply_verb
from truepath.errors import IllegalTransition
from truepath.measurement import faults as fault_words
from truepath.measurement.faults import (
    Fault,
    make_ended_early_fault,
    make_override_fault,
    make_runs_on_fault,
    make_silence_fault,
    make_target_fault,
    make_unable_fault,
)
from truepath.measurement.monitors.environment_reader import SensorPlausibility
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus
from truepath_drivers.interfaces.thermometers import Channel, Reading


def faults() -> Iterator[tuple[str, str]]:
    said = [one for one in vars(fault_words).values() if isinstance(one, Fault)]
    held = MotionStatus(MotionState.ALARM, (1.5, 20.0), 3, alarm="500 drive X")
    made = [
        make_ended_early_fault("XY", held, [5.0, 6.0]),
        make_override_fault(0.8),
        make_runs_on_fault("XY", held),
        make_silence_fault(10.0),
        make_target_fault("corner 2", 3.25),
        *(
            make_unable_fault(MotionStatus(state, (0.0,), 0, alarm=said), latched=True)
            for state, said in product(UNABLE, ("", "500 drive X"))
        ),
        *judged_faults(),
    ]
    yield from ((fault.code, fault.text) for fault in (*said, *made))
    yield "hold-unconfirmed", "the machine moves 3 s after a hold"
    for text in ("while the job was paused", "while the job was awaiting-move"):
        yield "interrupted", f"the service ended {text}"
    yield "interrupted", "the service was ended while the job was under way"
    with pytest.raises(IllegalTransition) as refused:
        apply_verb(Verb.ARM, State.RUNNING)
    yield "illegal-transition", str(refused.value)


def judged_faults() -> Iterator[Fault]:
    """Yield what is said of a sensor with no number, too much, the same, and again."""
    judge = SensorPlausibility(Channel("air_degC", -10.0, 60.0, stuck_s=100.0))
    shown = [(0.0, math.nan), (1.0, 99.0), (2.0, 20.0), (3.0, 20.5), (200.0, 20.5)]
    for host_time_s, value in shown:
        _, fault = judge.assess(Reading("air_degC", host_time_s, value))
        if fault:
            yield fault
    for name, altitude_m, shown in (
        ("pressure_hPa", None, (746.0,)),
        ("pressure_hPa", 120.0, (746.0,)),
        ("X_degC", None, (2.4e-41,)),
        ("X_degC", None, (0.0,)),
        ("X_degC", None, (20.0, 45.5)),
    ):
        judge = SensorPlausibility(Channel(name), altitude_m)
        for second, value in enumerate(shown):
            _, fault = judge.assess(Reading(name, 10.0 + second, value))
        yield fault
    group = {}
    judges = [SensorPlausibility(Channel(f"{n}_degC"), None, group) for n in "YZX"]
    for judge, value in zip(judges, (20.0, 20.5, 45.0), strict=True):
        _, fault = judge.assess(Reading(judge.channel.name, 10.0, value))
    yield fault


def temperature_refusals() -> Iterator[str]:
    refusing = ast.parse(inspect.getsource(temperature)).body
    refusing = [
        one for one in refusing if getattr(one, "name", "") != "combine_results"
    ]
    for node in (node for one in refusing for node in ast.walk(one)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "BadInput":
            (text,) = node.args
            parts = text.values if isinstance(text, ast.JoinedStr) else [text]
            yield "".join(
                str(part.value) if isinstance(part, ast.Constant) else "7"
                for part in parts
            )


def module(name):
    """The address of a script of the page, beside that which has begun it."""
    main = "document.querySelector('script[type=module]').src"
    return f"new URL('{name}.js', {main})"


def test_no_sentence_of_the_service_stays_english_on_a_german_page(panel):
    page = panel.open("#/connect", language="de")
    said = {
        "sayUnobservable": sorted(set(list_unobservable())),
        "sayTemperatureRefusal": sorted(set(temperature_refusals())),
    }
    assert all(len(texts) > 4 for texts in said.values())
    for function, texts in said.items():
        found = page.evaluate(
            f"async ([name, texts]) => {{"
            f" const module = await import({module('statements')});"
            " return texts.map((text) => module[name](text)); }",
            [function, texts],
        )
        for text, german in zip(texts, found, strict=True):
            assert german is not None, text
            left = set(re.findall(r"\w+", german.lower())) & ENGLISH
            assert not left, f"{text!r} is said as {german!r}"
    # Neither does a fault of a measurement.
    told = sorted(set(faults()))
    assert len(told) > 40
    problems = [{"code": code, "detail": text} for code, text in told]
    found = page.evaluate(
        f"async (problems) => {{"
        f" const {{ wordProblem }} = await import({module('problems')});"
        " const words = await Promise.all(problems.map(wordProblem));"
        " return words.map(({ text }) =>"
        " text instanceof Node || Array.isArray(text) ? null : text); }",
        problems,
    )
    for (code, text), german in zip(told, found, strict=True):
        assert german is not None, f"{code}: {text}"
        for number in re.findall(r"\d+\.\d+", text):
            assert number not in german, german
