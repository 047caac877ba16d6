"""A result that is not simply usable says so wherever a command takes or gives it."""

import json
import re
from dataclasses import replace

import pytest

from api_builders import edited
from truepath.cli.summary import print_result
from truepath.files.bundle.bundle import read_bundle
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.results import analysis

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
    assert after.endswith(" µm (k = 2)")
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
    verdict = command.json(*order)["verdict"]
    assert verdict == verdict_json(VERDICTS["not-usable"])
