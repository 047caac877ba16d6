"""The page as the service sends it, before any script runs."""

import json
import re
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from truepath.compensation.format_registry import list_formats
from truepath.kinematics.effects.family import list_families
from truepath.service.api.problems import BY_STATUS, PROBLEM_KINDS
from truepath.service.api.security.security import Guard
from truepath.service.page import pages
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


def test_the_shell_comes_in_german_to_a_german_browser(client):
    page = client.get("/", headers={"Accept-Language": "de"}).text
    assert '<html lang="de"' in page
    assert "ABBRUCH" in page


def test_the_shell_remembers_the_language_of_the_panel(client):
    client.cookies.set(pages.LANGUAGE_COOKIE, "de")
    assert '<html lang="de"' in client.get("/").text


def test_the_page_forbids_scripts_from_elsewhere_and_eval(client):
    policy = client.get("/").headers["content-security-policy"]
    assert "script-src 'self';" in policy
    assert "unsafe-eval" not in policy
    assert "http" not in policy


def test_abort_is_a_form_where_no_script_runs(client):
    page = client.get("/").text
    form = page[page.index('<form id="abort-form"') :]
    assert 'method="post" action="api/v1/stop"' in form[:200]


def test_a_browser_asks_before_it_reuses_a_file(client):
    first = client.get(f"{pages.STATIC_PATH}/js/main.js")
    assert first.headers["cache-control"] == "no-cache"
    again = client.get(
        f"{pages.STATIC_PATH}/js/main.js",
        headers={"If-None-Match": first.headers["etag"]},
    )
    assert again.status_code == 304


def test_a_browser_keeps_what_the_page_asks_for_as_long_as_the_page_is_the_same(client):
    script = re.search(r'src="(\S+/js/main\.js)"', client.get("/").text)[1]
    assert f"/{script}".startswith(f"{pages.STATIC_PATH}/{pages.digest_files()}/")
    kept = client.get(script)
    assert "immutable" in kept.headers["cache-control"]
    assert kept.text == client.get(f"{pages.STATIC_PATH}/js/main.js").text
    other = script.replace(pages.digest_files(), "0" * 16)
    assert client.get(other).status_code == 404  # of another version of the page


@pytest.mark.parametrize("language", pages.LANGUAGES)
def test_a_language_that_is_chosen_later_has_the_texts_of_effects_as_well(
    client, language
):
    asked = f"{pages.STATIC_PATH}/{pages.digest_files()}/locales/{language}.json"
    assert client.get(asked).json() == pages.catalogue(language)


def test_no_script_asks_for_a_file_past_the_digest():
    for path in OURS:
        assert f"{pages.STATIC_PATH}/" not in path.read_text(encoding="utf-8"), path


def test_catalogues_have_the_same_keys_and_the_same_blanks():
    first, *others = (pages.catalogue(language) for language in pages.LANGUAGES)
    for other in others:
        own = {k for k in other if not (TOLD.fullmatch(k) or PROBLEM.fullmatch(k))}
        assert own == {key for key in first if not PROBLEM.fullmatch(key)}
        assert {key for key in first if PROBLEM.fullmatch(key)} <= other.keys()
        for key, text in first.items():
            assert blanks(other[key]) == blanks(text), key


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


def blanks(text):
    return set(re.findall(r"\{\w+\}", text))


def test_no_catalogue_says_a_key_twice():
    for language in pages.LANGUAGES:
        text = (STATIC / "locales" / f"{language}.json").read_text(encoding="utf-8")
        keys = [key for key, _ in json.loads(text, object_pairs_hook=list)]
        assert len(keys) == len(set(keys))


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


def test_nothing_of_ours_names_a_host():
    for path in [*OURS, TEMPLATE]:
        text = path.read_text(encoding="utf-8").replace(
            "http://www.w3.org/2000/svg", ""
        )
        assert not re.search(r"https?://", text), path


def test_what_is_vendored_brings_its_licence():
    for folder in (STATIC / "vendor").iterdir():
        assert any(path.name.startswith("LICENSE") for path in folder.iterdir()), folder
