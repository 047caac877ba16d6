"""Page, certificate and README say things as a machinist says them."""

import re
import tomllib
from pathlib import Path

import pytest

from truepath.service.page.pages import catalogue

ROOT = Path(__file__).parents[3]
CERTIFICATE = ROOT / "app" / "truepath" / "answers" / "certificate" / "texts.toml"
REPLACED = {
    "en": re.compile(
        r"\b(foretold|held against|astray|knock(ed|s)?|anew|to and fro|errs|nobody"
        r"|somebody|anybody|whoever|by itself|under way|goes on|cut short|seldom"
        r"|tells?|told|stands (with|beside|on)|not met"
        r"|what (it|noise|is) (is held|alone|left))\b",
        re.IGNORECASE,
    ),
    "de": re.compile(
        r"\b(verr(ät|aten)|gehalten gegen|gegen \w+ gehalten|schein|des Scheins"
        r"|wie vorgefunden|wie verlassen|Volumetrischer Fehler|Es ging nicht)\b"
        r"|\b(?-i:Ziel|Ziele|Zielen|Stoß)\b",
        re.IGNORECASE,
    ),
}


def texts_of_the_certificate(language):
    texts = tomllib.loads(CERTIFICATE.read_text(encoding="utf-8"))
    return {key: text[language] for key, text in texts.items() if language in text}


@pytest.mark.parametrize("language", REPLACED)
@pytest.mark.parametrize("read", [catalogue, texts_of_the_certificate])
def test_no_replaced_phrase_is_left(read, language):
    texts = read(language)
    assert len(texts) > 100
    replaced = REPLACED[language]
    assert {key: text for key, text in texts.items() if replaced.search(text)} == {}


def test_no_replaced_phrase_is_left_in_the_readme_which_has_two_screens():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert REPLACED["en"].findall(readme) == []
    assert len(readme.splitlines()) <= 80
