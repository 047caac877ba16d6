"""A result that is not simply usable says so wherever a command takes or gives it."""

import json
import re
from dataclasses import replace

import pytest

from truepath.cli.command import run
from truepath.cli.summary import print_result
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.results import analysis

LEFT_OUT = Reason(
    "samples-left-out",
    "usable",
    {"samples": 42, "line": 7, "from_s": 61.2, "to_s": 61.3, "distance_um": 5012.0},
)
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})
VERDICTS = {
    "usable": Verdict((LEFT_OUT,)),
    "doubtful": Verdict((LEFT_OUT, OPEN)),
    "not-usable": Verdict((LEFT_OUT, OPEN, BEYOND)),
}


@pytest.fixture
def judged(analysed, tmp_path):
    """Write the result with another verdict; return its file."""

    def write(state):
        content = json.loads((analysed / "result.json").read_text())
        content["verdict"] = verdict_json(VERDICTS[state])
        file = tmp_path / f"{state}.json"
        file.write_text(json.dumps(content))
        return file

    return write


@pytest.fixture
def reference(tmp_path):
    file = tmp_path / "reference.csv"
    rows = "".join(f"EXX,{x},+,{0.01 * x},um\n" for x in range(0, 501, 50))
    file.write_text(f"error,position_mm,direction,value,unit\n{rows}")
    return file


def export(file, *more):
    output = file.parent / "tables" / "comp.tbl"
    arguments = ["--format", "linuxcnc", "-o", str(output), *more]
    return run(["export", str(file), *arguments]), output.parent


def test_a_result_that_is_not_to_be_used_is_not_exported(judged, capsys):
    status, folder = export(judged("not-usable"))
    assert status == 2
    assert not folder.exists()
    (line,) = capsys.readouterr().err.splitlines()
    assert "not-usable.json: the result is not to be used: " in line
    assert str(OPEN) in line
    assert str(BEYOND) in line
    assert str(LEFT_OUT) not in line
    assert line.endswith("--accept-verdict writes it all the same")


def test_it_is_exported_once_the_verdict_is_accepted(judged, capsys):
    status, folder = export(judged("not-usable"), "--accept-verdict")
    assert status == 0
    assert "warning: the result is not to be used: " in capsys.readouterr().err
    account = json.loads((folder / "comp.json").read_text())
    assert account["verdict"] == verdict_json(VERDICTS["not-usable"])


def test_files_of_a_control_that_takes_comments_say_it_themselves(judged, tmp_path):
    for state, said in (("not-usable", "NOT TO BE USED"), ("doubtful", "DOUBTFUL")):
        output = tmp_path / "tables" / f"{state}.ini"
        arguments = ["--format", "siemens-lec", "-o", str(output), "--accept-verdict"]
        assert run(["export", str(judged(state)), *arguments]) == 0
        assert f"; THE RESULT IS {said}" in output.read_text()


def test_a_doubtful_result_is_exported_with_a_warning(judged, capsys):
    status, folder = export(judged("doubtful"))
    assert status == 0
    assert f"warning: the result is doubtful: {OPEN}" in capsys.readouterr().err
    account = json.loads((folder / "comp.json").read_text())
    assert account["verdict"]["state"] == "doubtful"


def test_a_usable_result_is_exported_without_a_word_of_its_verdict(judged, capsys):
    status, folder = export(judged("usable"))
    assert status == 0
    (warning,) = re.findall("warning.*", capsys.readouterr().err)
    assert "temperature of the measurement is not known" in warning
    assert "THE RESULT IS" not in (folder / "comp-X.tbl").read_text()
    account = json.loads((folder / "comp.json").read_text())
    assert account["verdict"]["reasons"] == [str(LEFT_OUT)]


@pytest.mark.parametrize("as_json", [True, False])
def test_a_comparison_says_it_of_the_result(
    judged, reference, tmp_path, capsys, as_json
):
    out = tmp_path / "out"
    files = [str(judged("not-usable")), str(reference), "-o", str(out)]
    assert run(["compare", *files, *(["--json"] if as_json else [])]) == 0
    said = capsys.readouterr()
    assert "warning: the result is not to be used: " in said.err
    if as_json:
        assert json.loads(said.out)["verdict"]["state"] == "not-usable"
    else:
        assert said.out.startswith("*** NOT TO BE USED ***\n")
    content = json.loads((out / "comparison.json").read_text())
    assert content["verdict"] == verdict_json(VERDICTS["not-usable"])
    page = (out / "comparison.html").read_text()
    assert "<strong>Not to be used</strong>" in page


@pytest.mark.parametrize("state", VERDICTS)
def test_a_prediction_says_it_of_the_result(judged, points, tmp_path, capsys, state):
    out, objection = tmp_path / "out.csv", VERDICTS[state].objection
    arguments = ["--points", str(points), "-o", str(out), "--json"]
    assert run(["predict", str(judged(state)), *arguments]) == 0
    said = capsys.readouterr()
    assert (f"warning: the result is {objection}" in said.err) == bool(objection)
    assert json.loads(said.out)["verdict"] == verdict_json(VERDICTS[state])
    head, *rows = out.read_text().splitlines()
    assert head.endswith("uz_um,verdict" if objection else "uz_um")
    assert all(row.endswith(f",{state}") == bool(objection) for row in rows)


def of_another_run(file):
    """Let a result be made from a Run that nobody analyses here."""
    content = json.loads(file.read_text())
    for one in content["provenance"]["runs"]:
        one |= {"input_sha256": "f" * 64, "sketch": ""}
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize("command", ["analyse", "discover", "plan"])
def test_a_model_that_is_not_to_be_used_is_refused(
    judged, recorded, tmp_path, capsys, command
):
    model = of_another_run(judged("not-usable"))
    given = recorded / "machine.json" if command == "plan" else recorded
    out = tmp_path / "out"
    assert run([command, str(given), "--model", str(model), "-o", str(out)]) == 2
    assert f"not-usable.json is not to be used: {OPEN} {BEYOND}" in (
        capsys.readouterr().err
    )
    assert not list(out.rglob("*.json"))


def test_what_rests_on_a_doubtful_model_is_doubtful(judged, recorded, tmp_path, capsys):
    model = str(of_another_run(judged("doubtful")))
    said = f"doubtful: It rests on the model {model}, which is doubtful itself."
    out = tmp_path / "out"
    assert run(["analyse", str(recorded), "--model", model, "-o", str(out)]) == 0
    assert f"warning: the result is {said}" in capsys.readouterr().err
    content = json.loads((out / "result.json").read_text())
    assert content["verdict"]["state"] == "doubtful"
    machine, plan = str(recorded / "machine.json"), str(tmp_path / "plan")
    assert run(["plan", machine, "--minutes", "0.3", "--model", model, "-o", plan]) == 0
    assert f"warning: the plan is {said}" in capsys.readouterr().err
    page = (tmp_path / "plan" / "plan.html").read_text()
    assert 'class="verdict doubtful"' in page


def test_a_model_of_the_same_run_gives_no_numbers_and_is_taken(
    judged, recorded, tmp_path
):
    model, out = str(judged("not-usable")), tmp_path / "out"
    assert run(["analyse", str(recorded), "--model", model, "-o", str(out)]) == 0
    content = json.loads((out / "result.json").read_text())
    assert content["verdict"]["state"] == "usable"


def test_the_terminal_begins_with_the_worst(judged, tmp_path, capsys):
    content = json.loads(judged("not-usable").read_text())
    print_result(content, tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "*** NOT TO BE USED ***"
    assert lines[1] == f"- {BEYOND} {BEYOND.remedy}"
    assert lines[2] == f"- {OPEN} {OPEN.remedy}"
    assert lines[3] == f"- {LEFT_OUT} {LEFT_OUT.remedy}"


def test_many_reasons_do_not_hide_the_tables(judged, tmp_path, capsys):
    content = json.loads(judged("usable").read_text())
    content["verdict"] = verdict_json(Verdict((LEFT_OUT,) * 40))
    print_result(content, tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("- ") for line in lines) == 13
    assert "- and 28 more" in lines


@pytest.mark.parametrize("as_json", [True, False])
def test_analyse_warns_on_standard_error_and_succeeds(
    recorded, tmp_path, capsys, monkeypatch, as_json
):
    analyse = analysis.analyse

    def judge(*runs, **options):
        return replace(analyse(*runs, **options), verdict=VERDICTS["not-usable"])

    monkeypatch.setattr(analysis, "analyse", judge)
    more = ["--json"] if as_json else []
    assert run(["analyse", str(recorded), "-o", str(tmp_path / "out"), *more]) == 0
    said = capsys.readouterr()
    assert "warning: the result is not to be used: " in said.err
    if as_json:
        verdict = json.loads(said.out)["verdict"]
        assert verdict == verdict_json(VERDICTS["not-usable"])
    else:
        assert said.out.startswith("*** NOT TO BE USED ***\n")
