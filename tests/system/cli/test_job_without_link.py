"""The page of the job without a link, followed line by line on three makers' controls.

The controls are not the planner's, the machine is the simulators', and the recordings
are exports as a maker's software writes them.
"""

import json
import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from exports_of_makers import leica
from nc_controls import RUN
from truepath.cli.command import run
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.worlds import synthetic

PAGE = Path(__file__).parents[3] / "docs" / "without-a-link.md"
FORMATS = {"heidenhain": "heidenhain", "siemens-840d": "siemens", "fanuc": "fanuc"}
FENCE = re.compile(r"^ *```sh\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
SEED = 4


@pytest.fixture
def shop(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(shop, folder, dialect, tables=()):
    """Drive the program of a folder; export what the tracker saw meanwhile."""
    (program,) = (shop / folder / dialect).iterdir()
    driven = RUN[dialect](program.read_text()).recorded()
    content = json.loads((shop / "machine.json").read_text())
    loaded = LoadedTables.from_paths(tables)
    setting = synthetic.Setting(machine_seed=SEED, compensation=loaded)
    made = synthetic.record(content, driven, SEED + len(folder), "otf", setting)
    names = [f"N{k + 1}" for k in range(len(made))]
    return leica(made.time_s, made.position_mm, None, names)[0]


def spell(words, dialect, tables):
    """Words of the page for a control, with its program and its files."""
    spelled = []
    for before, word in pairwise(["", *words]):
        if before == "--format":
            spelled.append(FORMATS[dialect])
        elif before == "--compensation" and not word.endswith(".json"):
            spelled.append("")
        elif before == "--path":
            (program,) = Path(word.replace("heidenhain", dialect)).parent.iterdir()
            spelled.append(str(program))
        else:
            spelled.append(word.replace("heidenhain", dialect))
    if "" in spelled:
        first = spelled.index("") - 1
        last = len(spelled) - spelled[::-1].index("")
        each = [w for file in tables for w in ("--compensation", str(file))]
        spelled[first:last] = each
    return spelled


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("dialect", FORMATS)
def test_the_page_leads_from_nothing_to_the_certificate(dialect, shop):
    body = "".join(FENCE.findall(PAGE.read_text())).replace("\\\n", " ")
    lines = [shlex.split(line) for line in body.splitlines() if line.strip()]
    for words in lines:
        found = (shop / "tables").glob("*") if (shop / "tables").exists() else ()
        tables = sorted(file for file in found if file.suffix != ".json")
        program, *words = spell(words, dialect, tables)
        assert program == "truepath"
        if words[0] == "import":
            folder = {"recording.txt": "plan", "proof.txt": "proof"}[words[1]]
            (shop / words[1]).write_bytes(record(shop, folder, dialect, tables))
        assert run(words) == 0, words
    result = json.loads((shop / "result" / "result.json").read_text())
    assert result["verdict"]["state"] == "usable", result["verdict"]["reasons"]
    assert result["volumetric_error"]["before"]["mean"]["value_um"] > 10.0
    proof = json.loads((shop / "verification" / "verification.json").read_text())
    decided = {name: one["conformity"] for name, one in proof["conformity"].items()}
    assert decided["deviation"] == "within"
    # Tables of Fanuc carry positioning alone: what they leave, the result foretells.
    assert decided["measured"] == "within" or dialect == "fanuc"
    assert proof["agreement"]["consistent"]
    certificate = (shop / "certificate.html").read_text()
    assert "4711" in certificate
    assert "2026-03-01" in certificate  # of the recording
    # Circles are driven in place of the other points.
    circles = ["--verify", "circles-in-motion", "--control", dialect]
    assert run(["plan", "machine.json", "-o", "circles", *circles]) == 0
    (shop / "circles.txt").write_bytes(record(shop, "circles", dialect, tables))
    (program,) = (shop / "circles" / dialect).iterdir()
    given = ["--machine", "machine.json", "--path", str(program), "-o", "turned"]
    assert run(["import", "circles.txt", *given]) == 0
    files = [w for file in tables for w in ("--compensation", str(file))]
    files += ["--format", FORMATS[dialect]]
    assert run(["verify", "result/result.json", "turned", "-o", "round", *files]) == 0
    found = json.loads((shop / "round" / "verification.json").read_text())
    assert len(found["circles_in_motion"]) == 3  # in both senses each
    assert found["circles_missing"] == []
    assert found["agreement"]["consistent"]
