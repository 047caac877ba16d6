"""What the service says in English is said in every language of the page.

The words are collected where the service has them: one that is added there and not in
the catalogues is found here.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from tests.sentences_of_the_service import ENGLISH, list_unobservable

from truepath.answers.temperature import temperature_model
from truepath.catalogue.job import JobKind
from truepath.catalogue.live_notice import OnNotice
from truepath.catalogue.transitions import State, Verb, apply_verb
from truepath.compensation.installed import list_formats
from truepath.errors import IllegalTransition
from truepath.estimation.checks import change_search, notices
from truepath.estimation.solve.budget import SOURCES
from truepath.files.earlier.verdict import Verdict
from truepath.files.environment.refraction import CAUSES, Refraction
from truepath.kinematics import effects
from truepath.machines.cell_supervisor import MOVING
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
from truepath.measurement.messages import CellState
from truepath.measurement.monitors.channel_judge import ChannelJudge
from truepath.results.verdict import judge_air
from truepath.service.api.models.jobs.job_request import ADAPTIVE_MINUTES
from truepath.service.page.pages import LANGUAGES, catalogue
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus
from truepath_drivers.interfaces.thermometers import Channel, Reading

UNITS = (
    "um_per_m_K|um_per_m|um_per_s|urad_per_m|ppm_per_K|ppm_per_s"
    "|urad|rad|mm_s|um|mm|deg|ms|hz|s"
)


def keys_of_words() -> Iterator[str]:
    """Yield the key of each word that the page takes over from the service."""
    yield from (f"budget.{source}" for source in SOURCES)
    yield from (f"kind.{kind}" for kind in JobKind if kind is not JobKind.PLAN)
    yield from (f"state.{state}" for state in State)
    yield from (f"verdict.why.{kind}" for kind in CAUSES)
    yield from (f"notice.done_{action}" for action in OnNotice)
    changes = inspect.getsource(change_search), inspect.getsource(notices)
    named = re.findall(r'"((?:set-up|axes|line|lost|something)-[a-z-]+)"', str(changes))
    yield from (f"notice.{kind}" for kind in named)
    unable = {*CellState, "starting", "disconnected"} - {*MOVING, CellState.READY}
    yield from (f"condition.reason.{state}" for state in unable)
    for kind in list_formats().values():
        yield from (f"export.choice.{name}" for name in kind.choices)
        yield from (
            f"export.word.{w}" for words in kind.choices.values() for w in words
        )
    for file in Path(effects.__file__).parent.glob("*.py"):
        source = file.read_text("utf-8")
        for stem in re.findall(rf'"([a-z_]+?)_(?:{UNITS})"', source):
            yield f"parameter.{stem}"


def test_every_word_of_the_service_has_one_in_every_language():
    wanted = set(keys_of_words())
    assert len(wanted) > 80
    for language in LANGUAGES:
        assert wanted - catalogue(language).keys() == set()


@pytest.mark.parametrize("kind", CAUSES)
def test_why_the_air_is_not_corrected_comes_with_its_kind(kind):
    why = "" if kind == "nothing-known" else CAUSES[kind]
    (reason,) = judge_air([Refraction("nobody", why=why)], ["run"]).reasons
    assert reason.values == {"why": CAUSES[kind], "why_kind": kind}
    assert CAUSES[kind] in str(Verdict((reason,)).reasons[0])


def test_words_of_another_version_stand_as_they_are():
    (reason,) = judge_air([Refraction("nobody", why="fog")], ["run"]).reasons
    assert reason.values == {"why": "fog", "why_kind": ""}


def faults() -> Iterator[tuple[str, str]]:
    """Yield code and text of whatever ends or holds a measurement."""
    yield from ((f.code, f.text) for f in vars(fault_words).values() if _is_fault(f))
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
    yield from ((fault.code, fault.text) for fault in made)
    yield "hold-unconfirmed", "the machine moves 3 s after a hold"
    for text in ("while the job was paused", "while the job was awaiting-move"):
        yield "interrupted", f"the service ended {text}"
    yield "interrupted", "the service was ended while the job was under way"
    with pytest.raises(IllegalTransition) as refused:
        apply_verb(Verb.ARM, State.RUNNING)
    yield "illegal-transition", str(refused.value)


def _is_fault(value: object) -> bool:
    return isinstance(value, Fault)


def judged_faults() -> Iterator[Fault]:
    """Yield what is said of a sensor with no number, too much, the same, and again."""
    judge = ChannelJudge(Channel("air_degC", -10.0, 60.0, stuck_s=100.0))
    shown = [(0.0, math.nan), (1.0, 99.0), (2.0, 20.0), (3.0, 20.5), (200.0, 20.5)]
    for host_time_s, value in shown:
        _, fault = judge.judge(Reading("air_degC", host_time_s, value))
        if fault:
            yield fault
    for name, altitude_m, shown in (
        ("pressure_hPa", None, (746.0,)),
        ("pressure_hPa", 120.0, (746.0,)),
        ("X_degC", None, (2.4e-41,)),
        ("X_degC", None, (0.0,)),
        ("X_degC", None, (20.0, 45.5)),
    ):
        judge = ChannelJudge(Channel(name), altitude_m)
        for second, value in enumerate(shown):
            _, fault = judge.judge(Reading(name, 10.0 + second, value))
        yield fault
    group = {}
    judges = [ChannelJudge(Channel(f"{n}_degC"), None, group) for n in "YZX"]
    for judge, value in zip(judges, (20.0, 20.5, 45.0), strict=True):
        _, fault = judge.judge(Reading(judge.channel.name, 10.0, value))
    yield fault


def temperature_refusals() -> Iterator[str]:
    """Yield why the service says nothing of a machine's temperature."""
    tree = ast.parse(inspect.getsource(temperature_model))
    for node in ast.walk(tree):
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


@pytest.mark.ui
@pytest.mark.xdist_group("browser")
def test_no_sentence_of_the_service_stays_english_on_a_german_page(panel):
    page = panel.open("#/connect", language="de")
    said = {
        "sayUnobservable": sorted(set(list_unobservable())),
        "sayTemperatureRefusal": sorted(set(temperature_refusals())),
    }
    assert all(len(texts) > 4 for texts in said.values())
    for function, texts in said.items():
        for text in texts:
            found = page.evaluate(
                f"([name, text]) => import({module('statements')})"
                ".then((module) => module[name](text))",
                [function, text],
            )
            assert found is not None, text
            left = set(re.findall(r"\w+", found.lower())) & ENGLISH
            assert not left, f"{text!r} is said as {found!r}"


@pytest.mark.ui
@pytest.mark.xdist_group("browser")
def test_no_fault_of_a_measurement_stays_english_on_a_german_page(panel):
    page = panel.open("#/connect", language="de")
    said = sorted(set(faults()))
    assert len(said) > 40
    for code, text in said:
        found = page.evaluate(
            f"(problem) => import({module('problems')})"
            ".then(({ wordProblem }) => wordProblem(problem))"
            ".then(({ text }) => text instanceof Node || Array.isArray(text)"
            " ? null : text)",
            {"code": code, "detail": text},
        )
        assert found is not None, f"{code}: {text}"
        for number in re.findall(r"\d+\.\d+", text):
            assert number not in found, found


@pytest.mark.parametrize("language", LANGUAGES)
def test_an_adaptive_measurement_says_how_long_it_is_where_no_time_is_given(language):
    minutes = f" {ADAPTIVE_MINUTES:.0f} "
    assert minutes in catalogue(language)["plan.measure-adaptive"]
