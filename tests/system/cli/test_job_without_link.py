"""The page of the job without a link, followed line by line on three makers' controls.

The controls are not the planner's, the machine is the simulators', and the recordings
are exports as a maker's software writes them.
"""

import json
import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from exports_of_makers import polyworks
from nc_controls import RUN
from truepath.cli.command import run
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.worlds import synthetic

PAGE = Path(__file__).parents[3] / "docs" / "without-a-link.md"
FORMATS = {"heidenhain": "heidenhain", "siemens-840d": "siemens", "fanuc": "fanuc"}
FENCE = re.compile(r"^ *```sh\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
SEED = 4


@pytest.fixture(scope="module")
def lines():
    """Commands of the page, in order."""
    text = PAGE.read_text()
    body = "".join(FENCE.findall(text)).replace("\\\n", " ")
    return [shlex.split(line) for line in body.splitlines() if line.strip()]


@pytest.fixture
def shop(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(shop, folder, dialect, tables=()):
    """Drive the program of a folder, and export what the tracker saw meanwhile."""
    (program,) = (shop / folder / dialect).iterdir()
    driven = RUN[dialect](program.read_text()).recorded()
    content = json.loads((shop / "machine.json").read_text())
    setting = synthetic.Setting(
        machine_seed=SEED, compensation=LoadedTables.from_paths(tables)
    )
    made = synthetic.record(content, driven, SEED + len(folder), "otf", setting)
    status = np.zeros(len(made), int)
    names = [f"N{k + 1}" for k in range(len(made))]
    return polyworks(made.time_s, made.position_mm, status, names)[0]


def spell(words, dialect, tables):
    """Words of the page, for another control and the files that it has."""
    spelled = []
    for before, word in pairwise(["", *words]):
        if before == "--format":
            spelled.append(FORMATS[dialect])
        elif before == "--compensation" and not word.endswith(".json"):
            more = [w for file in tables[1:] for w in ("--compensation", str(file))]
            spelled += [str(tables[0]), *more]
        else:
            spelled.append(word.replace("heidenhain", dialect))
    return spelled


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("dialect", FORMATS)
def test_the_page_leads_from_nothing_to_the_certificate(dialect, lines, shop):
    tables = []
    for words in lines:
        assert words[0] == "truepath"
        words = spell(words[1:], dialect, tables)
        folder = {"recording.txt": "plan", "proof.txt": "proof"}.get(words[1])
        if words[0] == "import":
            text = record(shop, folder, dialect, tables)
            (shop / words[1]).write_bytes(text)
        place = words.index("--path") + 1 if "--path" in words else None
        if place:
            (program,) = shop.glob(words[place].rpartition("/")[0] + "/*")
            words[place] = str(program.relative_to(shop))
        print(*words)
        assert run(words) == 0, words
        if words[0] == "export":
            print([p.name for p in (shop / "tables").iterdir()])
            tables = sorted(
                p for p in (shop / "tables").iterdir() if p.suffix != ".json"
            )
    print(
        json.loads((shop / "verification/verification.json").read_text())["statements"]
    )
