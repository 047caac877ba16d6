"""`discover`: a measurement in, what its model lacks out; bad input in one line."""

import json

import pytest

from truepath.cli.command import run


@pytest.fixture(scope="module")
def discovered(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("discovered")
    assert run(["discover", str(recorded), "-o", str(folder)]) == 0
    return folder


def test_files_are_written_and_points_predicted(command, discovered, points, tmp_path):
    names = {path.name for path in discovered.iterdir() if path.is_file()}
    assert names == {"discovery.json", "model.json", "report.html"}
    content = json.loads((discovered / "discovery.json").read_text())
    assert content["schema"] == "discovery/1"
    assert content["effects"] == content["unnamed"] == []
    out, model = tmp_path / "predicted.csv", discovered / "model.json"
    command.run("predict", model, "--points", points, "-o", out)
    header, *rows = out.read_text().splitlines()
    assert header.endswith("dx_um,dy_um,dz_um,ux_um,uy_um,uz_um")
    assert len(rows) == 3


def test_a_model_of_no_use_is_refused(command, recorded, discovered, keep, tmp_path):
    content = json.loads((discovered / "model.json").read_text())

    def refuse(file):
        line = command.refuse("discover", recorded, "-o", tmp_path, "--model", file)
        assert file.name in line
        return line

    assert "cannot be read" in refuse(tmp_path / "missing.json")
    schema = refuse(keep({**content, "schema": "discovery/1"}))
    assert "schema is not that of a result or model" in schema
    assert "version is 1.5" in refuse(keep({**content, "version": 1.5}))
    content["machine"]["axes"]["X"]["max_mm"] += 100.0
    assert "machine.axes" in refuse(keep(content))
