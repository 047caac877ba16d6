"""`certificate`: what it states is what the result states, in both languages."""

import io
import json
import math
import re
from dataclasses import dataclass, field
from datetime import date
from html.parser import HTMLParser
from itertools import zip_longest

import pypdf
import pytest

from truepath.answers.certificate import pdf
from truepath.answers.certificate.issue import (
    gather_certificate,
    read_result_source,
)
from truepath.cli.command import run
from truepath.errors import BundleError
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

ISSUED = ("--issued", "2026-11-24")


@dataclass
class Page(HTMLParser):
    """The tables of a certificate by the section that they stand in."""

    tables: dict[str, list[list[list[str]]]] = field(default_factory=dict)
    text: str = ""
    _section: str = ""
    _in_cell: bool = False

    def __post_init__(self):
        super().__init__()

    def handle_starttag(self, tag, attrs):
        if tag == "section":
            self._section = dict(attrs)["id"]
        elif tag == "table":
            self.tables.setdefault(self._section, []).append([])
        elif tag == "tr":
            self.tables[self._section][-1].append([])
        elif tag in ("td", "th"):
            self.tables[self._section][-1][-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag):
        self._in_cell = self._in_cell and tag not in ("td", "th")

    def handle_data(self, data):
        self.text += data
        if self._in_cell:
            self.tables[self._section][-1][-1][-1] += data


def read_page(file):
    page = Page()
    page.feed(file.read_text(encoding="utf-8"))
    return page


def numbers(text):
    """The numbers of a cell, in either language."""
    plain = text.replace("−", "-").replace("\u202f", "").replace(",", ".")
    return [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", plain)]


@pytest.fixture
def issue(analysed, tmp_path):
    def certify(name, *more, result=None):
        file = tmp_path / name
        source = result or analysed / "result.json"
        words = ["certificate", str(source), "-o", str(file), *ISSUED, *more]
        return run(words), file

    return certify


@pytest.fixture
def result(analysed):
    return json.loads((analysed / "result.json").read_text())


@pytest.fixture
def judged(result, tmp_path):
    """A result file that says another thing of itself."""

    def judge(state):
        verdict = {"state": state, "reasons": ["The table shook."]}
        file = tmp_path / "judged.json"
        file.write_text(json.dumps({**result, "verdict": verdict}))
        return file

    return judge


def measure_again(result, tmp_path, **source):
    """Return the file of a result as of another measurement with that source."""
    again = json.loads(json.dumps(result))
    again["provenance"]["input_sha256"] = "a" * 64
    for one in again["runs"]:
        one["input_sha256"] = "b" * 64
        one["source"].update(source)
    file = tmp_path / "left.json"
    file.write_text(json.dumps(again))
    return file


def half_a_digit(text):
    """The rounding of the numbers of a cell."""
    decimals = re.search(r"[.,](\d+)", text)
    return 0.5000001 * 10.0 ** -(len(decimals[1]) if decimals else 0)


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_number_of_the_tables_is_the_results_and_u_is_twice_u(
    issue, result, language
):
    status, file = issue("c.html", "--language", language)
    assert status == 0
    seen = set()
    for table in read_page(file).tables["tables"]:
        head, *rows = table
        for column, title in enumerate(head[1:], start=1):
            symbol = title.split(",")[0]
            stated = result["error_tables"].get(symbol)
            if stated is None:
                continue
            seen.add(symbol)
            unit = "um" if "value_um" in stated else "urad"
            rest = (stated["position_mm"], stated[f"value_{unit}"])
            every = zip_longest(rows, *rest, stated[f"uncertainty_{unit}"])
            for (row, at, value, sigma), beyond in zip(
                every, stated["extrapolated"], strict=True
            ):
                assert row[0].endswith("*") == beyond
                assert numbers(row[0])[0] == pytest.approx(at, abs=0.0500001)
                shown, expanded = numbers(row[column])
                digit = half_a_digit(row[column])
                assert shown == pytest.approx(value, abs=digit)
                assert expanded == pytest.approx(2.0 * sigma, abs=digit)
    assert seen == set(result["error_tables"])


def test_squareness_volume_and_budget_are_those_of_the_result(issue, result):
    _, file = issue("c.html")
    tables = read_page(file).tables
    for symbol, _, cell in tables["single"][0][1:]:
        value, expanded = numbers(cell)[:2]
        stated = result["squareness_urad"][symbol]
        assert value == pytest.approx(stated["value"], abs=half_a_digit(cell))
        assert expanded == pytest.approx(
            2.0 * stated["uncertainty"], abs=half_a_digit(cell)
        )
    before = tables["brief"][0][1]
    mean = result["volumetric_error"]["before"]["mean"]
    assert numbers(before[1]) == pytest.approx(
        [mean["value_um"], 2.0 * mean["uncertainty_um"]], abs=half_a_digit(before[1])
    )
    *sources, total, expanded = tables["budget"][0][1:]
    squares = sum(numbers(row[4])[0] ** 2 for row in sources)
    stated = result["volumetric_uncertainty_um"]
    assert squares**0.5 == pytest.approx(stated, abs=2e-3)
    assert numbers(total[4])[0] == pytest.approx(stated, abs=6e-4)
    assert numbers(expanded[4])[0] == pytest.approx(2.0 * stated, abs=6e-4)


def test_the_reversal_value_is_twice_the_half_difference_of_the_result(
    issue, result, tmp_path
):
    position = result["error_tables"]["EYY"]["position_mm"]
    half = {
        "position_mm": position,
        "value_um": [-3.0] * len(position),
        "uncertainty_um": [0.05] * len(position),
    }
    direction = {"model": "constant", "half_difference": {"EYY": half}}
    file = tmp_path / "both.json"
    file.write_text(json.dumps({**result, "direction": direction}))
    page = read_page(issue("c.html", result=file)[1])
    rows = {row[0][0]: row for row in page.tables["iso"][0][1:]}
    assert numbers(rows["Y"][3])[0] == pytest.approx(6.0, abs=0.01)
    wider = numbers(rows["Y"][4])[0] - numbers(rows["Y"][2])[0]
    assert wider == pytest.approx(6.0, abs=0.11)
    assert rows["X"][3] == "–"
    own = result["measured_range"]["Y"]
    assert rows["Y"][1] == f"{own['from_mm']:.0f}\u00a0… {own['to_mm']:.0f}\u00a0mm"


def test_what_nobody_has_stated_is_shown_as_not_stated(issue, capsys):
    _, file = issue("c.html", "--state", "operator=Jörg Weiß")
    identity = dict(read_page(file).tables["identity"][0])
    assert identity["Operator"] == "Jörg Weiß"
    assert identity["Serial number of the tracker"] == "not stated"
    assert "not stated: machine_maker" in capsys.readouterr().err
    _, file = issue("d.html", "--language", "de")
    identity = dict(read_page(file).tables["identity"][0])
    assert identity["Bediener"] == "nicht angegeben"
    assert identity["Seriennummer des Trackers"] == "nicht angegeben"


@pytest.mark.parametrize(
    ("language", "texts"),
    [
        ("en", ["Calibration certificate", "Uncertainty budget", "Page 2 of "]),
        ("de", ["Kalibrierschein", "Verifizierung", "für", "Größte", "Seite 2 von "]),
    ],
)
def test_the_pdf_is_a_readable_document_of_a_few_pages(issue, language, texts):
    status, file = issue("c.pdf", "--language", language)
    assert status == 0
    document = pypdf.PdfReader(file)
    assert 5 <= len(document.pages) <= 12
    pages = [page.extract_text() for page in document.pages]
    for text in texts:
        assert any(text in page for page in pages), text
    assert all(len(page) > 400 for page in pages[:-1])  # none is empty


def test_the_same_result_makes_the_same_bytes(issue):
    assert issue("a.pdf")[1].read_bytes() == issue("b.pdf")[1].read_bytes()


def test_a_result_not_to_be_used_gives_no_certificate_unless_that_is_accepted(
    issue, judged, capsys
):
    status, file = issue("c.pdf", result=judged("not-usable"))
    assert status == 2
    assert not file.exists()
    assert "--accept-verdict" in capsys.readouterr().err
    _, file = issue("c.pdf", "--accept-verdict", result=judged("not-usable"))
    first = pypdf.PdfReader(file).pages[0].extract_text()
    assert "NOT TO BE USED" in first
    assert "The table shook." in first


def test_a_doubtful_result_states_its_reasons_on_the_first_page(issue, judged):
    _, file = issue("c.pdf", "--language", "de", result=judged("doubtful"))
    first = pypdf.PdfReader(file).pages[0].extract_text()
    assert "ZWEIFELHAFT" in first
    assert "The table shook." in first


def test_where_the_printer_is_missing_html_is_made_and_pdf_refused_with_the_remedy(
    issue, monkeypatch, capsys
):
    def is_missing():
        raise pdf.PdfUnavailable(f"no PDF can be made here (…): {pdf.REMEDY}")

    monkeypatch.setattr(pdf, "_load_printer", is_missing)
    status, file = issue("c.pdf")
    assert status == 2
    assert not file.exists()
    assert "pip install 'truepath[pdf]'" in capsys.readouterr().err
    assert issue("c.html")[0] == 0


def test_a_pdf_with_a_letter_that_no_font_has_is_refused(issue, capsys):
    customer = "customer=Werk \U0010fffd"
    status, file = issue("c.pdf", "--state", customer)
    assert status == 2
    assert not file.exists()
    assert "no installed font has \U0010fffd; install" in capsys.readouterr().err
    assert issue("c.html", "--state", customer)[0] == 0


def test_no_page_of_a_certificate_as_left_is_all_but_empty(issue, result, tmp_path):
    left = measure_again(result, tmp_path)
    _, file = issue("c.pdf", "--as-left", str(left), "--language", "de")
    pages = [page.extract_text() for page in pypdf.PdfReader(file).pages]
    assert all(len(page) > 400 for page in pages[:-1])


def test_files_beside_the_result_are_stated_and_held_against_it(
    issue, analysed, result, tmp_path
):
    account = tmp_path / "c.json"
    words = ["export", str(analysed / "result.json"), "--format", "json"]
    assert run([*words, "-o", str(tmp_path / "c.tables.json")]) == 0
    other = {"result": {"input_sha256": "f" * 64}}
    check = {"schema": "verification/1", "provenance": other}
    measured = {"conformity": "outside", "tolerance_um": 3.25}
    check |= {"conformity": {"measured": measured}, "statements": ["It fails."]}
    verification = tmp_path / "v.json"
    verification.write_text(json.dumps(check))
    left = ("--as-left", str(measure_again(result, tmp_path)))
    beside = ("--compensation", str(account), "--verification", str(verification))
    _, file = issue("c.html", *beside, *left)
    page = read_page(file)
    assert "IT WAS MADE FOR ANOTHER RESULT" in page.text
    assert "THE FILES WERE MADE FROM ANOTHER" not in page.text
    assert "does NOT keep the tolerance" in page.text
    assert "It fails." in page.text
    assert ["Tolerance at every place", "3.25 µm"] in page.tables["verification"][0]
    after = json.loads(account.read_text())["volumetric_error_um"]["after"]
    shown = dict(page.tables["compensation"][0])[
        "With the files, as the control reads them"
    ]
    assert numbers(shown)[:2] == pytest.approx(
        [after["mean"], 2.0 * after["mean_uncertainty"]], abs=half_a_digit(shown)
    )
    assert [row[0] for row in page.tables["brief"][0][1:]][-1] == "As left, measured"
    assert "the control has not said it" in page.text
    assert any(result["provenance"]["input_sha256"] in c for c in page.text.split())


ACTIVE = {"format": "json", "files_sha256": {"c.tables.json": "d" * 64}}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"compensated": True, "compensation": ACTIVE},
            "these files of the format json active: c.tables.json (SHA-256 dddddddd",
        ),
        ({"compensated": True}, "compensation files active, which it does not name"),
        ({"compensated": False}, "No account of compensation files was given."),
    ],
)
def test_files_that_a_verification_names_are_named_without_their_account(
    issue, tmp_path, content, words
):
    verification = tmp_path / "v.json"
    verification.write_text(json.dumps({"schema": "verification/1", **content}))
    _, file = issue("c.html", "--verification", str(verification))
    assert words in read_page(file).text


def test_a_verification_with_other_files_than_the_account_states_is_an_alarm(
    issue, analysed, tmp_path
):
    words = ["export", str(analysed / "result.json"), "--format", "json"]
    assert run([*words, "-o", str(tmp_path / "c.tables.json")]) == 0
    made = json.loads((tmp_path / "c.json").read_text())["files_sha256"]
    for digests, is_other in ((made, False), (ACTIVE["files_sha256"], True)):
        active = {"format": "json", "files_sha256": digests}
        content = {"schema": "verification/1", "compensated": True}
        verification = tmp_path / "v.json"
        verification.write_text(json.dumps({**content, "compensation": active}))
        beside = ("--compensation", str(tmp_path / "c.json"))
        _, file = issue("c.html", *beside, "--verification", str(verification))
        assert ("MADE WITH OTHER FILES" in read_page(file).text) == is_other


def test_only_a_later_measurement_with_compensation_states_the_machine_as_left(
    issue, analysed, result, tmp_path, capsys
):
    found = tmp_path / "found.json"
    for one in result["runs"]:
        one["source"]["started"] = "2026-03-02T08:00:00+00:00"
    found.write_text(json.dumps(result))

    def refuse(left):
        source, issued = read_result_source(found), date(2026, 3, 3)
        with pytest.raises(BundleError) as refused:
            gather_certificate(source, issued=issued, left=left, identity={})
        return str(refused.value)

    assert "a measurement of the result as found" in refuse(found)
    earlier = {"started": "2026-03-01T08:00:00+00:00"}
    assert "not after the result as found" in refuse(
        measure_again(result, tmp_path, **earlier)
    )
    later = {"started": "2026-03-02T12:00:00+00:00"}
    off = measure_again(result, tmp_path, **later, control_compensation="off")
    assert "its compensation is off" in refuse(off)
    assert issue("c.html", "--as-left", str(analysed / "result.json"))[0] == 2
    assert "a measurement of the result as found" in capsys.readouterr().err
    on = measure_again(result, tmp_path, **later, control_compensation="on")
    _, file = issue("c.html", "--as-left", str(on))
    assert "The control stated that its compensation was on" in read_page(file).text


def test_a_result_as_left_that_is_not_to_be_used_states_nothing(
    issue, result, tmp_path, capsys
):
    def leave(kind, values):
        again = {**result, "verdict": verdict_json(judge(kind, values))}
        return str(measure_again(again, tmp_path, started="2026-11-20T08:00:00+00:00"))

    def judge(kind, values):
        return Verdict((Reason(kind, "not-usable", values),))

    astray = leave("fit-beyond-noise", {"ratio": 9.0, "limit_ratio": 4.0})
    assert issue("c.html", "--as-left", astray)[0] == 2
    assert "left.json: the result as left is not to be used" in capsys.readouterr().err
    # Of a machine that is good there is little to gain.
    good = leave("little-gained", {"found_um": 0.5, "left_um": 0.6})
    status, file = issue("c.html", "--as-left", good)
    assert status == 0
    page = read_page(file)
    assert "As left, measured: The result may be used" in page.text
    assert "Date of measurement as left" in page.text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda machine: machine.update(tool_offset_mm=[0.0, 0.0, -10.0]),
            "has other targets",
        ),
        (lambda machine: machine["axes"]["X"].update(max_mm=300.0), "has other travel"),
    ],
)
def test_another_tool_or_travel_is_not_the_machine_as_left(
    issue, result, tmp_path, capsys, change, words
):
    again = json.loads(json.dumps(result))
    change(again["machine"])
    left = measure_again(again, tmp_path)
    assert issue("c.html", "--as-left", str(left))[0] == 2
    assert words in capsys.readouterr().err


def test_a_file_of_another_kind_is_refused_by_its_name(issue, analysed, capsys):
    status, _ = issue("c.html", "--verification", str(analysed / "result.json"))
    assert status == 2
    assert "verification/1" in capsys.readouterr().err
    assert issue("c.txt")[0] == 2
    assert ".pdf or .html" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a["volumetric_error_um"]["after"].update(mean=math.nan), "mean"),
        (lambda a: a.pop("volumetric_error_um"), "volumetric_error_um is missing"),
        (lambda a: a["left_um"].update(map=math.inf), "left_um.map is not finite"),
    ],
)
def test_an_account_that_cannot_be_stated_is_refused_with_its_place(
    issue, analysed, tmp_path, capsys, change, said
):
    file = tmp_path / "t.json"
    words = ["export", str(analysed / "result.json"), "--format", "csv"]
    assert run([*words, "-o", str(tmp_path / "t.csv")]) == 0
    account = json.loads(file.read_text())
    change(account)
    file.write_text(json.dumps(account))
    capsys.readouterr()
    assert issue("c.html", "--compensation", str(file))[0] == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "t.json: " in line
    assert said in line


def test_the_html_fetches_nothing_and_has_no_script(issue):
    _, file = issue("c.html")
    html = file.read_text(encoding="utf-8")
    assert not re.search(r"<script|https?://|url\(|@import|<link|<img", html)
    assert io.StringIO(html).readline().strip() == "<!DOCTYPE html>"
