"""`certificate`: what it states is what the result states, in both languages."""

import copy
import json
import math
import re
from itertools import zip_longest
from types import SimpleNamespace

import pytest
import tinyhtml5

from truepath.answers.certificate import document
from truepath.cli.command import run
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

ISSUED = ("--issued", "2026-11-24")
ACTIVE = {"format": "json", "files_sha256": {"c.tables.json": "d" * 64}}


def read_page(file):
    tree = tinyhtml5.parse(file, namespace_html_elements=False)
    tables = {
        section.get("id"): [
            [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]
            for table in section.iter("table")
        ]
        for section in tree.iter("section")
    }
    return SimpleNamespace(text="".join(tree.itertext()), tables=tables)


def numbers(text):
    plain = text.replace("−", "-").replace("\u202f", "").replace(",", ".")
    return [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", plain)]


@pytest.fixture(scope="module")
def account(analysed, few_places, tmp_path_factory):
    """The account of exported files; not to be changed."""
    folder = tmp_path_factory.mktemp("account")
    words = ["export", str(analysed / "result.json"), "--format", "json"]
    assert run([*words, "-o", str(folder / "c.tables.json")]) == 0
    return folder / "c.json"


@pytest.fixture(scope="module")
def issued(analysed, tmp_path_factory):
    """The page of the result in both languages, with a name of its operator."""
    folder, words = tmp_path_factory.mktemp("issued"), ["certificate"]
    words += [str(analysed / "result.json"), *ISSUED, "--state", "operator=Jörg Weiß"]
    for language in ("en", "de"):
        file = folder / f"{language}.html"
        assert run([*words, "-o", str(file), "--language", language]) == 0
    return folder


@pytest.fixture
def words(analysed, tmp_path):
    def spell(name, *more, result=analysed / "result.json"):
        return ["certificate", result, "-o", tmp_path / name, *ISSUED, *more]

    return spell


@pytest.fixture
def issue(command, words, tmp_path):
    def certify(name, *more, **source):
        command.run(*words(name, *more, **source))
        return tmp_path / name

    return certify


@pytest.fixture
def refuse(command, words, tmp_path):
    def ask(name, *more, **source):
        said = command.refuse(*words(name, *more, **source))
        assert not (tmp_path / name).exists()
        return said

    return ask


@pytest.fixture
def verified(keep):
    def write(**content):
        content = {"schema": "verification/1", **content}
        return "--verification", keep(content, "v.json")

    return write


def assert_shown(cell, value, sigma):
    """A cell states value and expanded uncertainty, rounded in the last digit."""
    decimals = re.search(r"[.,](\d+)", cell)
    half_a_digit = 0.5000001 * 10.0 ** -(len(decimals[1]) if decimals else 0)
    assert numbers(cell)[:2] == pytest.approx([value, 2.0 * sigma], abs=half_a_digit)


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_number_of_tables_is_the_results_and_u_twice_u(issued, result, language):
    seen = set()
    for table in read_page(issued / f"{language}.html").tables["tables"]:
        head, *rows = table
        for column, title in enumerate(head[1:], start=1):
            symbol = title.split(",")[0]
            stated = result["error_tables"].get(symbol)
            if stated is None:
                continue
            seen.add(symbol)
            unit = "um" if "value_um" in stated else "urad"
            rest = (stated["position_mm"], stated[f"value_{unit}"])
            rest += (stated[f"uncertainty_{unit}"], stated["extrapolated"])
            for row, at, value, sigma, beyond in zip_longest(rows, *rest):
                assert row[0].endswith("*") == beyond
                assert numbers(row[0])[0] == pytest.approx(at, abs=0.0500001)
                assert_shown(row[column], value, sigma)
    assert seen == set(result["error_tables"])


def test_squareness_volume_and_budget_are_those_of_the_result(issued, result):
    tables = read_page(issued / "en.html").tables
    for symbol, _, cell in tables["single"][0][1:]:
        stated = result["squareness_urad"][symbol]
        assert_shown(cell, stated["value"], stated["uncertainty"])
    mean = result["volumetric_error"]["before"]["mean"]
    assert_shown(tables["brief"][0][1][1], mean["value_um"], mean["uncertainty_um"])
    *sources, expanded = tables["budget"][0][1:]
    squares = sum(numbers(row[4])[0] ** 2 for row in sources)
    stated = result["volumetric_uncertainty_um"]
    assert squares**0.5 == pytest.approx(2.0 * stated, abs=4e-3)
    assert numbers(expanded[4])[0] == pytest.approx(2.0 * stated, abs=6e-4)


def test_the_reversal_value_is_twice_the_half_difference_stated(issue, result, keep):
    position = result["error_tables"]["EYY"]["position_mm"]
    columns = {"value_um": -3.0, "uncertainty_um": 0.05}
    half = {name: [value] * len(position) for name, value in columns.items()}
    half["position_mm"] = position
    direction = {"model": "constant", "half_difference": {"EYY": half}}
    page = read_page(issue("c.html", result=keep({**result, "direction": direction})))
    rows = {row[0][0]: row for row in page.tables["iso"][0][1:]}
    assert numbers(rows["Y"][3])[0] == pytest.approx(6.0, abs=0.01)
    wider = numbers(rows["Y"][4])[0] - numbers(rows["Y"][2])[0]
    assert wider == pytest.approx(6.0, abs=0.11)
    assert rows["X"][3] == "–"
    own = result["measured_range"]["Y"]
    assert rows["Y"][1] == f"{own['from_mm']:.0f}\u00a0… {own['to_mm']:.0f}\u00a0mm"


UNKNOWN = {
    "en": ("Operator", "Serial number of the tracker", "not stated"),
    "de": ("Bediener", "Seriennummer des Trackers", "nicht angegeben"),
}


@pytest.mark.parametrize("language", UNKNOWN)
def test_what_nobody_stated_is_not_stated_and_nothing_is_fetched(issued, language):
    identity = dict(read_page(issued / f"{language}.html").tables["identity"][0])
    operator, serial, unknown = UNKNOWN[language]
    assert (identity[operator], identity[serial]) == ("Jörg Weiß", unknown)
    html = (issued / f"{language}.html").read_text(encoding="utf-8")
    assert not re.search(r"<script|https?://|url\(|@import|<link|<img", html)
    assert html.splitlines()[0] == "<!DOCTYPE html>"


STATED = {
    "laboratory": "Measuring room, 1 Example Street",
    "customer": "Example Mill, ask for B. Klein",
    "received_on": "2026-11-20",
    "authorised_by": "C. Roth",
    "condition": "spindle replaced",
    "deviations": "none",
    "tracker_certificate": "T-77",
    "tracker_calibrated_on": "2026-05-04",
}


def test_another_content_has_another_number_and_a_translation_the_same(issue, issued):
    def number_on(file):
        return re.search(r"TP-\d{8}-[0-9A-F]{8}", file.read_text())[0]

    (number,) = {number_on(issued / f"{language}.html") for language in ("en", "de")}
    assert number_on(issue("other.html", "--state", "operator=A. Weiß")) != number


def test_it_has_what_iso_17025_asks_for(issue):
    words = [word for k, v in STATED.items() for word in ("--state", f"{k}={v}")]
    page = read_page(issue("c.html", *words))
    for text in STATED.values():
        assert text in page.text
    assert "traceable to the SI" in page.text
    assert "certificate T-77, calibrated on: 2026-05-04" in page.text
    for text in (
        "ISO 230-1",
        "relate only to the machine",
        "reproduced only in full",
        "supplied by the customer",
        "None: no tolerance was agreed.",
        "End of calibration certificate TP-",
    ):
        assert text in page.text
    bare = read_page(issue("bare.html")).text
    assert "Traceability to the SI is not shown" in bare
    assert "SIMULATED" not in bare


@pytest.mark.parametrize("how", ["reported", "stated"])
def test_simulated_devices_are_named_on_it(issue, result, keep, how):
    stated = ()
    if how == "reported":
        result["runs"][0]["source"]["motion"] = "Truepath Simulated CNC SIM-C000001 1.0"
    else:
        stated = ("--state", "tracker=simulated tracker")
    page = issue("c.html", *stated, result=keep(result)).read_text(encoding="utf-8")
    assert page.count("SIMULATED DEVICES") == 2  # above the title, and of every page


def test_iso_14253_decides_conformity(issue, result):
    p95 = result["volumetric_error"]["before"]["p95"]
    value, half = p95["value_um"], 2.0 * p95["uncertainty_um"]
    for limit, said in (
        (value + 1.1 * half, "conforms"),
        (value - 1.1 * half, "does NOT conform"),
        (value, "not decided"),
    ):
        page = read_page(issue("c.html", "--tolerance-um", f"{limit:.3f}"))
        (row,) = page.tables["conformity"][0][1:]
        assert row[1] == f"{limit:.2f}"
        assert (row[2], row[4]) == (page.tables["brief"][0][1][2], said)
        assert "ISO 14253-1 with a guard band of U" in page.text


PROVED = {
    "conformity": "outside",
    "tolerance_um": 5.0,
    "length_um": 5.6,
    "expanded_uncertainty_um": 0.4,
    "coverage_factor": 3.2,
}


def test_the_conformity_of_a_verification_has_its_own_k(issue, verified):
    check = {"conformity": {"measured": PROVED}, "places": {"row": [1, 2, 3]}}
    page = read_page(issue("c.html", *verified(**check, compensated=True)))
    (row,) = page.tables["conformity"][0][1:]
    assert row[0] == "Verification with compensation: deciding place of 3"
    assert row[1:] == ["5.00", "5.60 ± 0.40", "3.2", "does NOT conform"]
    other = {"provenance": {"result": {"input_sha256": "f" * 64}}}
    page = read_page(issue("c.html", *verified(**check, **other)))
    assert "None: no tolerance was agreed." in page.text


def test_a_bad_result_gives_no_certificate_unless_accepted(issue, refuse, result, keep):
    verdict = {"state": "not-usable", "reasons": ["The table shook."]}
    file = keep({**result, "verdict": verdict})
    assert "--accept-verdict" in refuse("c.html", result=file)
    words = ("--accept-verdict", "--tolerance-um", "100")
    page = read_page(issue("c.html", *words, result=file))
    assert "NOT TO BE USED" in page.text
    assert "None: the result is not to be used." in page.text
    assert "The table shook." in page.text


def test_without_a_printer_html_alone_is_made(command, words, refuse, monkeypatch):
    def is_missing():
        raise document.PdfUnavailable(f"no PDF can be made here (…): {document.REMEDY}")

    monkeypatch.setattr(document, "_load_printer", is_missing)
    assert "pip install 'truepath[pdf]'" in refuse("c.pdf")
    assert "not stated: machine_maker" in command.run(*words("c.html")).err


def test_files_beside_it_are_checked(issue, account, result, verified, measure_again):
    other = {"result": {"input_sha256": "f" * 64}}
    check = {"provenance": other, "statements": ["It fails."]}
    measured = {"conformity": "outside", "tolerance_um": 3.25}
    check |= {"conformity": {"measured": measured}}
    left = ("--as-left", measure_again(result))
    beside = ("--compensation", account, *verified(**check))
    page = read_page(issue("c.html", *beside, *left))
    assert "IT WAS MADE FOR ANOTHER RESULT" in page.text
    assert "THE FILES WERE MADE FROM ANOTHER" not in page.text
    assert "does NOT keep the tolerance" in page.text
    assert "It fails." in page.text
    assert ["Tolerance at every place", "3.25 µm"] in page.tables["verification"][0]
    after = json.loads(account.read_text())["volumetric_error_um"]["after"]
    rows = dict(page.tables["compensation"][0])
    shown = rows["With the files, as the control reads them"]
    assert_shown(shown, after["mean"], after["mean_uncertainty"])
    assert [row[0] for row in page.tables["brief"][0][1:]][-1] == "As left, measured"
    assert "the control has not said it" in page.text
    assert any(result["provenance"]["input_sha256"] in c for c in page.text.split())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            {"compensated": True, "compensation": ACTIVE},
            "these files of the format json active: c.tables.json (SHA-256 dddddddd",
        ),
        ({"compensated": True}, "compensation files active, which it does not name"),
        ({"compensated": False}, "No account of compensation files was given."),
    ],
)
def test_a_verification_names_its_files_without_account(issue, verified, content, said):
    assert said in read_page(issue("c.html", *verified(**content))).text


def test_a_verification_with_files_of_another_account_alarms(issue, account, verified):
    made = json.loads(account.read_text())["files_sha256"]
    for active, is_other in (({**ACTIVE, "files_sha256": made}, False), (ACTIVE, True)):
        check = verified(compensated=True, compensation=active)
        page = read_page(issue("c.html", "--compensation", account, *check))
        assert ("MADE WITH OTHER FILES" in page.text) == is_other


def test_as_left_is_a_later_measurement(issue, refuse, result, keep, measure_again):
    for one in result["runs"]:
        one["source"]["started"] = "2026-03-02T08:00:00+00:00"
    found = keep(result, "found.json")

    def explain(left):
        return refuse("c.html", "--as-left", left, result=found)

    assert "a measurement of the result as found" in explain(found)
    earlier = measure_again(result, started="2026-03-01T08:00:00+00:00")
    assert "not after the result as found" in explain(earlier)
    later = {"started": "2026-03-02T12:00:00+00:00"}
    off = measure_again(result, **later, control_compensation="off")
    assert "its compensation is off" in explain(off)
    on = measure_again(result, **later, control_compensation="on")
    page = read_page(issue("c.html", "--as-left", on, result=found))
    assert "The control stated that its compensation was on" in page.text


def test_curves_tables_and_squareness_are_those_as_found_and_as_left(
    issue, issued, result, measure_again
):
    again = copy.deepcopy(result)
    again["squareness_urad"]["C0Y"]["value"] += 100.0
    again["error_tables"]["EXX"]["value_um"][3] += 100.0
    file = issue("c.html", "--as-left", measure_again(again))
    page = read_page(file)
    assert page.tables["single"][0][0][2:] == ["As found", "As left, measured"]
    (row,) = [row for row in page.tables["single"][0] if row[0] == "C0Y"]
    found, left = (numbers(cell)[0] for cell in row[2:])
    assert left - found == pytest.approx(100.0, abs=1.0)
    exx = [t for t in page.tables["tables"] if "EXX, µm" in t[0]]
    before, after = (numbers(t[4][t[0].index("EXX, µm")])[0] for t in exx)
    assert after - before == pytest.approx(100.0, abs=1.0)
    assert len(page.tables["iso"]) == 2
    alone = (issued / "en.html").read_text(encoding="utf-8")
    for text, curves in ((alone, 1), (file.read_text(encoding="utf-8"), 2)):
        section = text.split('<section id="curves">')[1].split("</section>")[0]
        assert section.count("<svg ") == 3
        assert section.count("EXX  Positioning of X") == 1
        colours = ("#1f63c6", "#b45309")[:curves]
        assert all(colour in section for colour in colours)
    assert "Blue: as found; orange: as left." not in alone


def test_a_bad_result_as_left_states_nothing(issue, refuse, result, measure_again):
    def leave(kind, values):
        verdict = verdict_json(Verdict((Reason(kind, "not-usable", values),)))
        started = "2026-11-20T08:00:00+00:00"
        return measure_again({**result, "verdict": verdict}, started=started)

    astray = leave("fit-beyond-noise", {"ratio": 9.0, "limit_ratio": 4.0})
    said = refuse("c.html", "--as-left", astray)
    assert "left.json: the result as left is not to be used" in said
    # Of a machine that is good there is little to gain.
    good = leave("little-gained", {"found_um": 0.5, "left_um": 0.6})
    page = read_page(issue("c.html", "--as-left", good))
    assert "As left, measured: The result may be used" in page.text
    assert "Date of measurement as left" in page.text


def test_another_tool_or_travel_is_no_machine_as_left(refuse, result, measure_again):
    again = copy.deepcopy(result)
    again["machine"]["axes"]["X"]["max_mm"] = 300.0
    assert "has other travel" in refuse("c.html", "--as-left", measure_again(again))
    result["machine"]["tool_offset_mm"] = [0.0, 0.0, -10.0]
    assert "has other targets" in refuse("c.html", "--as-left", measure_again(result))


def test_a_file_of_another_kind_is_refused_by_its_name(refuse, analysed):
    said = refuse("c.html", "--verification", analysed / "result.json")
    assert "verification/1" in said
    assert ".pdf or .html" in refuse("c.txt")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a["volumetric_error_um"]["after"].update(mean=math.nan), "mean"),
        (lambda a: a.pop("volumetric_error_um"), "volumetric_error_um is missing"),
        (lambda a: a["left_um"].update(map=math.inf), "left_um.map is not finite"),
    ],
)
def test_a_damaged_account_is_refused_by_its_key(refuse, account, keep, change, said):
    content = json.loads(account.read_text())
    change(content)
    line = refuse("c.html", "--compensation", keep(content, "t.json"))
    assert "t.json: " in line
    assert said in line
