"""What a person sees: progress, failures, and results that are not simply usable."""

import errno
import json
import re
import shutil
from dataclasses import replace
from importlib.metadata import version
from math import nan

import pytest

from api_builders import edited
from truepath.cli.command import run, run_command
from truepath.cli.summary import print_result
from truepath.cli.terminal import print_table, show_progress
from truepath.errors import AlignmentError, BadInput, BundleError
from truepath.files.bundle.bundle import read_bundle
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.results import analysis
from truepath_drivers.interfaces.errors import DeviceTimeout


def failing(error):
    def call():
        raise error

    return call


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (BadInput("no such thing"), 2, "truepath: no such thing"),
        (
            BundleError("is not a number", file="path.csv", row=3, column="x_mm"),
            2,
            "truepath: path.csv, row 3, column x_mm: is not a number",
        ),
        (AlignmentError("paths\n differ"), 1, "truepath: paths differ"),
        (DeviceTimeout("the tracker is silent"), 1, "truepath: the tracker is silent"),
        (FileNotFoundError(errno.ENOENT, "lost", "a.csv"), 2, "truepath: a.csv: lost"),
        (OSError(errno.ENOSPC, "full", "out"), 1, "truepath: out: full"),
        (KeyboardInterrupt(), 1, "truepath: interrupted"),
    ],
)
def test_a_failure_is_one_line_and_a_status(error, status, line, capsys):
    assert run_command(failing(error)) == status
    captured = capsys.readouterr()
    assert (captured.err, captured.out) == (line + "\n", "")


def test_a_fault_of_the_program_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        run_command(failing(ZeroDivisionError()))
    with pytest.raises(OSError, match="nameless"):
        run_command(failing(OSError("nameless")))


@pytest.mark.parametrize(("answer", "status"), [(None, 0), (1, 1), (3, 1), (130, 1)])
def test_success_is_zero_and_any_other_status_a_one(answer, status):
    assert run_command(lambda: answer) == status


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["calibrate"], "calibrate"),
        (["analyse"], "BUNDLE"),
        (["analyse", "bundle"], "--output"),
        (["analyse", "bundle", "-o"], "-o"),
        (["predict", "result.json", "-o", "out.csv"], "--points"),
        (["serve", "--port", "many"], "--port"),
        (["serve", "--port", "70000"], "--port"),
        (["demo", "--speed", "0"], "--speed"),
        (["demo", "--everything"], "--everything"),
        (["demo", "-o", "out", "--fault", "cnc:boredom"], "'cnc:boredom': unknown"),
    ],
)
def test_a_wrong_command_line_is_bad_input_in_one_line(arguments, said, capsys):
    assert run(arguments) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert said in line


def test_each_command_explains_itself_and_has_the_distributions_version(command):
    for name in ("serve", "demo", "analyse", "predict"):
        assert "Usage: " in command.run(name, "--help").out
    assert "Calibrates machine tools" in command.run().out
    assert command.run("--version").out.strip() == version("truepath")


def test_a_log_gets_a_line_a_stage(capsys):
    with show_progress("measure") as report:
        for share in (0.0, 0.2, 0.5):
            report(share, "measuring", f"{share} lost")
        report(1.0, "closing")
        report(1.0, "")
    said = capsys.readouterr()
    assert said.err.splitlines() == ["measure: measuring", "measure: closing"]
    assert said.out == ""


def test_a_terminal_gets_a_bar_and_tables_keep_columns(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with show_progress("measure") as report:
        report(0.25, "measuring", "8000 samples, 0 lost")
    said = capsys.readouterr()
    for word in ("measuring", "25%", "8000 samples, 0 lost"):
        assert word in said.err
    assert said.out == ""
    print_table("Errors", ("error", "value"), [("EXX", "1.5"), ("C0Y", "-20.0")])
    lines = capsys.readouterr().out.splitlines()
    assert any("EXX" in line and line.rstrip().endswith("1.5 │") for line in lines)


@pytest.mark.parametrize("is_beside", [False, True])
def test_a_bad_known_length_is_one_line(is_beside, command, bundle, tmp_path):
    file = bundle.with_name(f"{bundle.name}.known_lengths.csv")
    file.write_text(
        "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,length_mm,u_mm\n"
        "1000,0,0,3000,0,0,2000,0.001\n1000,0,0,3000,0,0,2000,-1\n"
    )
    option = []
    if not is_beside:
        file = file.rename(tmp_path / "bar.csv")
        option = ["--known-length", file]
    said = command.refuse("analyse", bundle, *option, "-o", tmp_path / "out")
    assert said.startswith(f"{file.name}, row 3, column u_mm: is -1; state the")
    assert not (tmp_path / "out").exists()


def test_a_damaged_zip_or_no_bundle_is_one_line(command, bundle, tmp_path):
    archive = tmp_path / "bundle.zip"
    shutil.make_archive(str(tmp_path / "bundle"), "zip", bundle)
    archive.write_bytes(archive.read_bytes()[:-300])
    for place in (archive, tmp_path / "nowhere"):
        assert place.name in command.refuse("analyse", place, "-o", tmp_path / "out")


def test_an_output_folder_that_is_a_file_is_one_line(command, recorded, tmp_path):
    (tmp_path / "out").write_text("mine")
    said = command.refuse("analyse", recorded, "-o", tmp_path / "out")
    assert said.endswith("out: is a file; name a folder for the results")
    assert (tmp_path / "out").read_text() == "mine"


@pytest.fixture
def refuse(command, points, tmp_path):
    def ask(result):
        out = tmp_path / "out.csv"
        said = command.refuse("predict", result, "--points", points, "-o", out)
        assert not out.exists()
        return said

    return ask


def test_bad_points_and_a_bad_result_are_one_line(refuse, analysed, points, tmp_path):
    file = tmp_path / "result.json"
    assert "result.json: cannot be read (No such file or directory)" in refuse(file)
    file.write_text('{"schema": ')
    assert "result.json, row 1: is not JSON" in refuse(file)
    points.write_text("x_mm,y_mm,z_mm\n1,nan,3\n")
    line = refuse(analysed / "result.json")
    assert "points.csv, row 2, column y_mm: is empty" in line


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("length_scale_ppm", "0.6", 'length_scale_ppm is "0.6"; write a number'),
        ("length_scale_ppm", -5.0, "length_scale_ppm is -5; it must be"),
        ("measured_s", nan, "measured_s is not finite; write a finite"),
        ("temperature_degC", {"X": [nan, 20.0]}, "temperature_degC.X[0] is not finite"),
        ("temperature_degC", "warm", 'temperature_degC is "warm"; write an'),
        ("runs", [{"name": "a", "sketch": "123"}], 'runs[0].sketch is "123"'),
        ("runs", "monday", 'runs is "monday"'),
    ],
)
def test_a_result_of_bad_provenance_is_one_line(key, value, line, refuse, result, keep):
    result["provenance"][key] = value
    assert f"result.json: provenance.{line}" in refuse(keep(result))


@pytest.mark.parametrize("value", [1e12, -1e308])
def test_an_error_that_no_machine_has_is_one_line(value, refuse, result, keep):
    effects = result["model"]["effects"]
    place = next(k for k, one in enumerate(effects) if "values_um" in one)
    effects[place]["values_um"][2] = value
    line = refuse(keep(result))
    assert f"result.json: model.effects[{place}].values_um[2] is {value:g}" in line


ASIDE = {"samples": 42, "line": 7, "from_s": 61.2, "to_s": 61.3, "distance_um": 5012.0}
LEFT_OUT = Reason("samples-left-out", "usable", ASIDE)
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})
VERDICTS = {
    "usable": Verdict((LEFT_OUT,)),
    "doubtful": Verdict((LEFT_OUT, OPEN)),
    "not-usable": Verdict((LEFT_OUT, OPEN, BEYOND)),
}


@pytest.fixture
def judged(result, keep):
    def write(state):
        verdict = verdict_json(VERDICTS[state])
        return keep({**result, "verdict": verdict}, f"{state}.json")

    return write


@pytest.fixture
def words(tmp_path):
    def spell(file, *more):
        place = tmp_path / "tables" / "comp.ini"
        return ["export", file, "--format", "siemens-lec", "-o", place, *more]

    return spell


@pytest.fixture
def read(tmp_path):
    def made():
        folder = tmp_path / "tables"
        account = json.loads((folder / "comp.json").read_text())
        return (folder / "comp.ini").read_text(), account

    return made


def test_bad_results_need_consent(few_places, command, words, judged, read, tmp_path):
    file = judged("not-usable")
    line = command.refuse(*words(file))
    assert not (tmp_path / "tables").exists()
    assert "not-usable.json: the result is not to be used: " in line
    assert str(OPEN) in line
    assert str(BEYOND) in line
    assert str(LEFT_OUT) not in line
    assert line.endswith("--accept-verdict writes it all the same")
    said = command.run(*words(file, "--accept-verdict"))
    assert "warning: the result is not to be used: " in said.err
    text, account = read()
    assert "; THE RESULT IS NOT TO BE USED" in text
    assert account["verdict"] == verdict_json(VERDICTS["not-usable"])


def test_a_doubtful_result_alone_is_warned_of(few_places, command, words, judged, read):
    said = command.run(*words(judged("doubtful")))
    assert f"warning: the result is doubtful: {OPEN}" in said.err
    text, account = read()
    assert "; THE RESULT IS DOUBTFUL" in text
    assert account["verdict"]["state"] == "doubtful"
    said = command.run(*words(judged("usable")))
    (warning,) = re.findall("warning.*", said.err)
    assert "temperature of the measurement is not known" in warning
    text, account = read()
    assert "THE RESULT IS" not in text
    assert account["verdict"]["reasons"] == [str(LEFT_OUT)]


def test_a_comparison_says_it_of_the_result(command, judged, tmp_path):
    reference, out = tmp_path / "reference.csv", tmp_path / "out"
    rows = "".join(f"EXX,{x},+,{0.01 * x},um\n" for x in range(0, 501, 50))
    reference.write_text(f"error,position_mm,direction,value,unit\n{rows}")
    order = ["compare", judged("not-usable"), reference, "-o", out]
    said = command.run(*order)
    assert "warning: the result is not to be used: " in said.err
    assert said.out.startswith("*** NOT TO BE USED ***\n")
    assert command.json(*order)["verdict"]["state"] == "not-usable"
    content = json.loads((out / "comparison.json").read_text())
    assert content["verdict"] == verdict_json(VERDICTS["not-usable"])
    assert "<strong>Not to be used</strong>" in (out / "comparison.html").read_text()


@pytest.mark.parametrize("state", VERDICTS)
def test_a_prediction_says_it_of_the_result(command, judged, points, tmp_path, state):
    out, objection = tmp_path / "out.csv", VERDICTS[state].objection
    order = ["predict", judged(state), "--points", points, "-o", out, "--json"]
    said = command.run(*order)
    assert (f"warning: the result is {objection}" in said.err) == bool(objection)
    assert json.loads(said.out)["verdict"] == verdict_json(VERDICTS[state])
    head, *rows = out.read_text().splitlines()
    assert head.endswith("uz_um,verdict" if objection else "uz_um")
    assert all(row.endswith(f",{state}") == bool(objection) for row in rows)


def of_another_run(file):
    with edited(file) as content:
        for one in content["provenance"]["runs"]:
            one |= {"input_sha256": "f" * 64, "sketch": ""}
    return file


@pytest.mark.parametrize("order", ["analyse", "discover", "plan"])
def test_a_model_not_to_be_used_is_refused(command, judged, recorded, tmp_path, order):
    model = of_another_run(judged("not-usable"))
    given = recorded / "machine.json" if order == "plan" else recorded
    out = tmp_path / "out"
    said = command.refuse(order, given, "--model", model, "-o", out)
    assert f"not-usable.json is not to be used: {OPEN} {BEYOND}" in said
    assert not list(out.rglob("*.json"))


def test_what_rests_on_a_doubtful_model_is_so_too(command, judged, recorded, tmp_path):
    model = of_another_run(judged("doubtful"))
    said = f"doubtful: It rests on the model {model}, which is doubtful itself."
    out = tmp_path / "out"
    told = command.run("analyse", recorded, "--model", model, "-o", out)
    assert f"warning: the result is {said}" in told.err
    content = json.loads((out / "result.json").read_text())
    assert content["verdict"]["state"] == "doubtful"
    asked = ["--minutes", "0.3", "--feed", "9000", "--control", "linuxcnc"]
    given = [recorded / "machine.json", "--model", model, "-o", out]
    assert f"warning: the plan is {said}" in command.run("plan", *given, *asked).err
    assert 'class="verdict doubtful"' in (out / "plan.html").read_text()
    # A bad one of the same Run is taken.
    command.run("analyse", recorded, "--model", judged("not-usable"), "-o", out)
    content = json.loads((out / "result.json").read_text())
    assert content["verdict"]["state"] == "usable"


def test_the_terminal_shows_the_worst_first_and_the_next_step(result, tmp_path, capsys):
    def show(verdict):
        print_result(result | {"verdict": verdict_json(verdict)}, tmp_path)
        return capsys.readouterr().out.splitlines()

    verdict, before, after, following = show(VERDICTS["doubtful"])[-4:]
    assert verdict == "verdict: doubtful"
    mean = result["volumetric_error"]["before"]["mean"]["value_um"]
    assert before.startswith(f"volumetric error: mean {mean:.1f} ± ")
    assert after.startswith("after compensation: mean ")
    assert before.endswith(" µm (k = 2; grid, mean of both directions)")
    assert after.endswith(" µm (k = 2; the same, all corrected)")
    assert following.startswith(f"next: truepath export {tmp_path / 'result.json'} ")
    lines = show(VERDICTS["not-usable"])
    assert "next: " not in "\n".join(lines)
    assert lines[0] == "*** NOT TO BE USED ***"
    assert lines[1:4] == [f"- {one} {one.remedy}" for one in (BEYOND, OPEN, LEFT_OUT)]
    lines = show(Verdict((LEFT_OUT,) * 40))
    assert sum(line.startswith("- ") for line in lines) == 13
    assert "- and 28 more" in lines


def test_analyse_warns_on_stderr_and_succeeds(command, recorded, tmp_path, monkeypatch):
    found = analysis.analyse(read_bundle(recorded))
    judged = replace(found, verdict=VERDICTS["not-usable"])
    monkeypatch.setattr(analysis, "analyse", lambda *runs, **options: judged)
    order = ["analyse", recorded, "-o", tmp_path / "out"]
    said = command.run(*order)
    assert "warning: the result is not to be used: " in said.err
    assert said.out.startswith("*** NOT TO BE USED ***\n")
    assert command.json(*order)["verdict"] == verdict_json(VERDICTS["not-usable"])
