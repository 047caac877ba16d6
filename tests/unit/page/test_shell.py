"""The page as the service sends it, before any script runs, and the words it has."""

import inspect
import json
import re
from itertools import product
from pathlib import Path
from string import Formatter

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from truepath.catalogue import job, transitions
from truepath.compensation.format_registry import list_formats
from truepath.estimation.checks import change_detection
from truepath.estimation.solve.budget import SOURCES
from truepath.files.earlier.verdict import SENTENCES, TITLES, Verdict
from truepath.files.environment import CAUSES, Refraction
from truepath.kinematics import effects
from truepath.kinematics.effects.family import list_families
from truepath.machines import conditions
from truepath.machines.cell_status import MOVING
from truepath.measurement.messages import CellState
from truepath.results.result_assessment import assess_air
from truepath.service.api.guard import Guard
from truepath.service.api.models.job_request import ADAPTIVE_MINUTES
from truepath.service.api.problems import BY_STATUS, PROBLEM_KINDS
from truepath.service.page import pages
from truepath.service.page.pages import LANGUAGES, catalogue
from truepath_drivers.interfaces.records import UNABLE

ROOT = Path(__file__).parents[3]
STATIC = ROOT / "app" / "truepath" / "service" / "page" / "static"
TEMPLATE = STATIC.parent / "templates" / "index.html"
FAULTS = ROOT / "app" / "truepath" / "measurement" / "faults.py"
OURS = [
    path
    for path in sorted(STATIC.rglob("*"))
    if path.suffix in {".js", ".css", ".svg"} and "vendor" not in path.parts
]
# A template of a script with a word of the service in it stands for a family of keys.
BUILT = re.compile(r"`((?:[a-z]+\.)[\w.-]*\$\{[^`]*)`")
# Told by the service in English, and so translated into the other languages only.
PROBLEM = re.compile(r"problem\.code\.[\w.-]+")
TOLD = re.compile(
    r"effect\.[\w-]+\.(cause|looks_like|remedy)"
    r"|format\.[\w-]+\.(control|carries|not_carried|note|note_[\w-]+)"
)


@pytest.fixture
def client():
    app = FastAPI()
    app.include_router(pages.router)
    app.mount(pages.STATIC_PATH, pages.static_files())
    app.add_middleware(Guard)
    return TestClient(app, base_url="http://localhost")


@pytest.mark.parametrize(
    ("remembered", "accepted", "language"),
    [
        (None, None, "en"),
        (None, "de-CH, en;q=0.8", "de"),
        (None, "fr, en;q=0.3, de;q=0.6", "de"),
        (None, "fr", "en"),
        ("en", "de", "en"),
        ("xx", "de", "de"),
        (None, "de;q=nonsense, en;q=0.1", "en"),
    ],
)
def test_the_operators_choice_comes_before_the_browsers(remembered, accepted, language):
    assert pages.choose_language(remembered, accepted) == language


def test_the_shell_comes_in_german_to_a_german_browser_or_panel(client):
    page = client.get("/", headers={"Accept-Language": "de"}).text
    assert '<html lang="de"' in page
    assert "ABBRUCH" in page
    client.cookies.set(pages.LANGUAGE_COOKIE, "de")
    assert '<html lang="de"' in client.get("/").text


def test_the_page_forbids_foreign_scripts_and_eval_and_aborts_without_any(client):
    page = client.get("/")
    policy = page.headers["content-security-policy"]
    assert "script-src 'self';" in policy
    assert "unsafe-eval" not in policy
    assert "http" not in policy
    _, _, form = page.text.partition('<form id="abort-form"')
    assert 'method="post" action="api/v1/stop"' in form[:200]


def test_a_browser_keeps_the_files_of_this_page_and_asks_before_reusing_others(client):
    script = re.search(r'src="(\S+/js/main\.js)"', client.get("/").text)[1]
    assert f"/{script}".startswith(f"{pages.STATIC_PATH}/{pages.digest_files()}/")
    kept = client.get(script)
    assert "immutable" in kept.headers["cache-control"]
    other = script.replace(pages.digest_files(), "0" * 16)
    assert client.get(other).status_code == 404  # of another version of the page
    bare = f"{pages.STATIC_PATH}/js/main.js"
    first = client.get(bare)
    assert first.text == kept.text
    assert first.headers["cache-control"] == "no-cache"
    again = client.get(bare, headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304


@pytest.mark.parametrize("language", pages.LANGUAGES)
def test_a_language_chosen_later_has_the_texts_of_effects_as_well(client, language):
    asked = f"{pages.STATIC_PATH}/{pages.digest_files()}/locales/{language}.json"
    assert client.get(asked).json() == pages.catalogue(language)


def test_catalogues_have_the_same_keys_and_the_same_blanks():
    first, *others = (pages.catalogue(language) for language in pages.LANGUAGES)
    for other in others:
        own = {k for k in other if not (TOLD.fullmatch(k) or PROBLEM.fullmatch(k))}
        assert own == {key for key in first if not PROBLEM.fullmatch(key)}
        assert {key for key in first if PROBLEM.fullmatch(key)} <= other.keys()
        for key, text in first.items():
            assert blanks(other[key]) == blanks(text), key
    for language in pages.LANGUAGES:  # and none says one twice
        text = (STATIC / "locales" / f"{language}.json").read_text(encoding="utf-8")
        keys = [key for key, _ in json.loads(text, object_pairs_hook=list)]
        assert len(keys) == len(set(keys))


def test_effects_and_formats_have_words_in_the_languages_the_service_does_not_speak():
    names = {f"effect.{family.name}" for family in list_families()}
    words = {f"{n}.{w}" for n in names for w in ("cause", "looks_like", "remedy")}
    told = ("control", "carries", "not_carried", "note")
    for name, kind in list_formats().items():
        words |= {f"format.{name}.{word}" for word in told}
        less_usual = [word for known in kind.choices.values() for word in known[1:]]
        words |= {f"format.{name}.note_{word}" for word in less_usual}
    for language in pages.LANGUAGES:
        known = pages.catalogue(language)
        assert names <= known.keys(), language
        told = {key for key in known if TOLD.fullmatch(key)}
        assert told == (set() if language == "en" else words), language


def test_every_text_is_used_and_every_used_text_exists():
    sources = [TEMPLATE, *(path for path in OURS if path.suffix == ".js")]
    written = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    known = set(pages.catalogue("en"))
    used = set(re.findall(r"\bt\(\s*\"([a-z]+\.[\w-]+)\"", written))
    used |= set(re.findall(r"text\[[\"']([a-z]+\.[\w-]+)[\"']\]", written))
    assert used <= known
    built = re.compile("|".join(map(_family, BUILT.findall(written))))
    idle = {
        key
        for key in known - used
        if f'"{key}"' not in written and not built.fullmatch(key)
    }
    assert idle == set()


def _family(template):
    """Return what matches each key that a template of a script can make."""
    fixed = re.split(r"\$\{[^}]*\}", template)
    return r"[\w.-]+".join(map(re.escape, fixed))


def test_every_problem_has_a_title_and_a_way_out_in_every_language():
    kinds = {kind.code for kind in (*PROBLEM_KINDS.values(), *BY_STATUS.values())}
    faults = set(re.findall(r'Fault\(\s*"([a-z-]+)"', FAULTS.read_text("utf-8")))
    faults |= {f"motion-{state}" for state in UNABLE}
    faults |= {"closure", "cancel-overdue"}  # told by the job
    for language in pages.LANGUAGES:
        known = pages.catalogue(language).keys()
        assert {f"problem.code.{code}" for code in faults} <= known
        if language != "en":
            codes = kinds | faults
            assert {f"problem.code.{code}" for code in codes} <= known
            assert {f"problem.code.{code}_action" for code in codes} <= known


def test_nothing_of_ours_names_a_host_or_a_file_past_the_digest():
    for path in [*OURS, TEMPLATE]:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", text), path
        assert path == TEMPLATE or f"{pages.STATIC_PATH}/" not in text, path


def test_what_is_vendored_brings_its_licence():
    for folder in (STATIC / "vendor").iterdir():
        assert any(path.name.startswith("LICENSE") for path in folder.iterdir()), folder


UNITS = (
    "um_per_m_K|um_per_m|um_per_s|urad_per_m|ppm_per_K|ppm_per_s"
    "|urad|rad|mm_s|um|mm|deg|ms|hz|s"
)


def keys_of_words():
    """Yield the key of each word that the page takes over from the service."""
    yield from (f"budget.{source}" for source in SOURCES)
    yield from (f"kind.{kind}" for kind in job.JobKind if kind is not job.JobKind.PLAN)
    yield from (f"state.{state}" for state in transitions.State)
    yield from (f"verdict.why.{kind}" for kind in CAUSES)
    yield from (f"notice.done_{action}" for action in job.OnNotice)
    yield from (f"condition.{kind}" for kind in conditions.ConditionType)
    source = inspect.getsource(conditions)
    stated = re.findall(r'Finding\(\s*Level\.FALSE, "([a-z-]+)"', source)
    assert len(stated) > 10
    stems = product(("compensation", "compensation-not", "not-told"), ("on", "off"))
    stated += ["-".join(words) for words in stems]
    yield from (f"condition.reason.{reason}" for reason in (*stated, *UNABLE))
    changes = inspect.getsource(change_detection)
    named = re.findall(r'"((?:set-up|axes|line|lost|something)-[a-z-]+)"', changes)
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
