"""What the service says in English is said in every language of the page.

The words are collected where the service has them: one that is added there and not in
the catalogues is found here.
"""

import inspect
import re
from itertools import product
from pathlib import Path
from string import Formatter

import pytest

from truepath.catalogue.job import JobKind
from truepath.catalogue.live_notice import OnNotice
from truepath.catalogue.transitions import State
from truepath.compensation.format_registry import list_formats
from truepath.estimation.checks import change_detection, notices
from truepath.estimation.solve.budget import SOURCES
from truepath.files.earlier.verdict import SENTENCES, TITLES, Verdict
from truepath.files.environment.refraction import CAUSES, Refraction
from truepath.kinematics import effects
from truepath.machines.cell_supervisor import MOVING
from truepath.machines.conditions import condition_log
from truepath.machines.conditions.conditions import ConditionType
from truepath.measurement.messages import CellState
from truepath.results.result_assessment import assess_air
from truepath.service.api.models.jobs.job_request import ADAPTIVE_MINUTES
from truepath.service.page.pages import LANGUAGES, catalogue
from truepath_drivers.interfaces.records import UNABLE

UNITS = (
    "um_per_m_K|um_per_m|um_per_s|urad_per_m|ppm_per_K|ppm_per_s"
    "|urad|rad|mm_s|um|mm|deg|ms|hz|s"
)


def keys_of_words():
    """Yield the key of each word that the page takes over from the service."""
    yield from (f"budget.{source}" for source in SOURCES)
    yield from (f"kind.{kind}" for kind in JobKind if kind is not JobKind.PLAN)
    yield from (f"state.{state}" for state in State)
    yield from (f"verdict.why.{kind}" for kind in CAUSES)
    yield from (f"notice.done_{action}" for action in OnNotice)
    yield from (f"condition.{kind}" for kind in ConditionType)
    source = inspect.getsource(condition_log)
    stated = re.findall(r'Finding\(\s*Level\.FALSE, "([a-z-]+)"', source)
    assert len(stated) > 10
    stems = product(("compensation", "compensation-not", "not-told"), ("on", "off"))
    stated += ["-".join(words) for words in stems]
    yield from (f"condition.reason.{reason}" for reason in (*stated, *UNABLE))
    changes = inspect.getsource(change_detection), inspect.getsource(notices)
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


def test_every_word_and_usual_time_of_the_service_is_in_every_language():
    wanted = set(keys_of_words())
    assert len(wanted) > 80
    for language in LANGUAGES:
        texts = catalogue(language)
        assert wanted - texts.keys() == set()
        assert f" {ADAPTIVE_MINUTES:.0f} " in texts["plan.measure-adaptive"]


def test_why_the_air_is_not_corrected_comes_with_its_kind_or_as_another_version_said():
    for kind, why in {**CAUSES, "": "fog"}.items():
        told = "" if kind == "nothing-known" else why
        (reason,) = assess_air([Refraction("nobody", why=told)], ["run"]).reasons
        assert reason.values == {"why": why, "why_kind": kind}
        assert why in str(Verdict((reason,)).reasons[0])


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_reason_has_words_in_every_language(language):
    texts = catalogue(language)
    for kind, (english, remedy) in SENTENCES.items():
        assert blanks(texts[f"verdict.{kind}"]) == blanks(english), kind
        assert bool(texts.get(f"verdict.{kind}_remedy")) == bool(remedy), kind
        if language == "en":
            assert texts[f"verdict.{kind}"] == english
            assert texts.get(f"verdict.{kind}_remedy", "") == remedy
    if language == "en":
        titles = {state: title for state, title in TITLES.items() if state != "usable"}
        assert {state: texts[f"verdict.{state}"] for state in titles} == titles


def blanks(text):
    return {name for _, name, _, _ in Formatter().parse(text) if name}
