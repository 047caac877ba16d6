"""`certificate`: the PDF is a readable document, alike each time."""

import logging
import re
from datetime import UTC, datetime

import pypdf
import pytest

from truepath.answers.certificate import issued_certificates
from truepath.answers.certificate.issue import CertificateOrder

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
    assert 5 <= len(pages) <= 16
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
    assert not [one for one in caplog.records if one.name.startswith("weasyprint")]
    assert "no installed font has \U0010fffd; install" in said
    command.run(*words("usable", "c.html", *customer))


PLACES = {
    "row": [1, 2, 3],
    "position": [[0.0, 0.0, 0.0], [250.0, 200.0, 150.0], [500.0, 400.0, 300.0]],
    "conformity": ["within", "outside", "undecided"],
}
MEASURED = {
    "conformity": "outside",
    "tolerance_um": 5.0,
    "length_um": 5.6,
    "expanded_uncertainty_um": 0.4,
    "coverage_factor": 3.2,
}
STATED = {"tracker": "Simulated tracker", "serial_number": "4711", "customer": "Mill"}
SIZE = r"(\d+[.,]\d+ ± \d+[.,]\d+)"
NUMBER = r"(TP-[\d-]+)"
# Each number that is on it more than once, in all the places where it is.
TWICE = {
    "number": (rf"{NUMBER}",),
    "serial": (r"Seriennummer (\d+)", r"Seriennummer der Maschine (\d+)"),
    "tolerance": (
        r"entscheidender von 3 Orten (\d,\d+)",
        r"Toleranz an jeder Stelle (\d,\d+) µm",
        r"bei einer Toleranz von (\d,\d+) µm",
    ),
    "worst": (rf"entscheidender von 3 Orten \d,\d+ {SIZE}",),
    "factor": (rf"entscheidender von 3 Orten \d,\d+ {SIZE} (\d,\d)", r"k = (3,\d)"),
    "places": (r"entscheidender von (\d+)", r"entscheidende von (\d+)"),
    "p95": (
        rf"Ausgangszustand {SIZE} {SIZE}",
        rf"Ausgangszustand: 95 % der Orte darunter \d+,\d+ {SIZE}",
    ),
    "p95 as left": (
        rf"Endzustand, gemessen {SIZE} {SIZE}",
        rf"Endzustand, gemessen: 95 % der Orte darunter \d+,\d+ {SIZE}",
    ),
}


@pytest.fixture
def read_back(result, keep, measure_again, tmp_path):
    """The record of a certificate with all parts, and the text of its pages."""
    result["verdict"] = {"state": "usable", "reasons": []}
    check = {"schema": "verification/1", "places": PLACES, "compensated": True}
    check["conformity"] = {"measured": MEASURED}
    check["agreement"] = {"consistent": True, "chance": 0.4}
    check["agreement"] |= {"share_within_expanded": 0.95, "chance_of_any_machine": 0.5}
    order = CertificateOrder(
        "TP-20261124-1",
        keep(result),
        datetime(2026, 11, 24, tzinfo=UTC),
        "anna",
        measure_again(result),
        keep(check, "v.json"),
        identity=STATED,
        language="de",
        tolerance_um=12.0,
    )
    record = issued_certificates.issue_certificate(order, tmp_path / "certificates")
    record = issued_certificates.read_certificate(
        tmp_path / "certificates", record["number"]
    )
    file = tmp_path / "certificates" / record["number"] / "certificate.pdf"
    pages = [page.extract_text() for page in pypdf.PdfReader(file).pages]
    return record, [" ".join(page.split()) for page in pages]


def find_all(pattern, text):
    """The last group of each match."""
    return [found[found.re.groups] for found in re.finditer(pattern, text)]


def test_no_number_of_a_pdf_contradicts_another_or_the_record(read_back):
    record, pages = read_back
    text = " ".join(pages)
    for name, patterns in TWICE.items():
        found = [find_all(pattern, text) for pattern in patterns]
        assert all(found), f"{name}: {found}"
        assert len({one for each in found for one in each}) == 1, f"{name}: {found}"
    assert record["number"] in text
    for one in record["results"]["volumetric_error"]:
        for size in (one["mean"], one["p95"], one["largest"]):
            assert is_shown(size, pages[0]), one["state"]
    decided = record["results"]["conformity"]
    assert [one["of"] for one in decided] == ["before", "after_left", "verification"]
    for one in decided:
        assert is_shown(one["size"], pages[0])
        assert f"{one['tolerance_um']:.2f}".replace(".", ",") in pages[0]


def is_shown(size, text):
    """Value and expanded uncertainty, rounded in their last digits."""
    pairs = re.findall(r"(\d+,?(\d*)) ± (\d+,?\d*)", text)
    return any(
        abs(float(number.replace(",", ".")) - stated)
        <= 0.5000001 * 10.0 ** -len(digits)
        for value, digits, half in pairs
        for number, stated in ((value, size["value_um"]),)
        if abs(float(half.replace(",", ".")) - size["expanded_uncertainty_um"])
        <= 0.5000001 * 10.0 ** -len(digits)
    )


def test_pages_have_number_count_and_what_was_simulated_and_the_end_a_mark(read_back):
    record, pages = read_back
    for count, page in enumerate(pages, start=1):
        assert f"Seite {count} von {len(pages)}" in page
        assert record["number"] in page
        assert "SIMULIERTE GERÄTE" in page
    end = f"Ende des Kalibrierscheins {record['number']}"
    assert [end in page for page in pages] == [False] * (len(pages) - 1) + [True]
    for said in ("ISO 14253-1 mit einem Schutzabstand von U", "Mill", "anna"):
        assert said in pages[0]
    text = " ".join(pages)
    for name, count in (("konform", 1), ("NICHT konform", 1), ("nicht entschieden", 1)):
        assert f"{name}: {count}" in text  # of the places that are drawn
    assert "k = 1)" not in text
