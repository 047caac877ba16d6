"""`certificate`: the PDF is a readable document, alike each time."""

import logging

import pypdf
import pytest

ISSUED = ("--issued", "2026-11-24")


@pytest.fixture
def words(result, keep, tmp_path):
    def spell(state, name, *more):
        verdict = {"state": state, "reasons": ["The table shook."]}
        file = keep({**result, "verdict": verdict})
        return ["certificate", file, "-o", tmp_path / name, *ISSUED, *more]

    return spell


def read_pages(file, *texts):
    pages = [page.extract_text() for page in pypdf.PdfReader(file).pages]
    assert 5 <= len(pages) <= 12
    for text in texts:
        assert any(text in page for page in pages), text
    return pages


@pytest.mark.long
def test_a_result_not_to_be_used_is_printed_alike(command, words, tmp_path):
    one, other = tmp_path / "a.pdf", tmp_path / "b.pdf"
    for name in (one.name, other.name):
        command.run(*words("not-usable", name, "--accept-verdict"))
    assert one.read_bytes() == other.read_bytes()
    texts = ("Calibration certificate", "Uncertainty budget", "Page 2 of ")
    first, *_ = read_pages(one, *texts)
    assert "NOT TO BE USED" in first
    assert "The table shook." in first


def test_a_doubtful_result_in_german(command, words, result, measure_again, tmp_path):
    left = ("--as-left", measure_again(result), "--language", "de")
    command.run(*words("doubtful", "c.pdf", *left))
    texts = ("Kalibrierschein", "Verifizierung", "für", "Größte", "Seite 2 von ")
    pages = read_pages(tmp_path / "c.pdf", *texts)
    assert "ZWEIFELHAFT" in pages[0]
    assert "The table shook." in pages[0]
    assert all(len(page) > 400 for page in pages[:-1])  # none is all but empty


@pytest.mark.parametrize("level", [logging.WARNING, logging.CRITICAL])
def test_a_letter_of_no_font_is_in_html_alone(command, words, caplog, level):
    caplog.set_level(level)
    customer = ("--state", "customer=Werk \U0010fffd")
    said = command.refuse(*words("usable", "c.pdf", *customer))
    assert "no installed font has \U0010fffd; install" in said
    command.run(*words("usable", "c.html", *customer))
