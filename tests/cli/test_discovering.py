"""`discover`: a measurement in, what its model lacks out; bad input in one line."""

import json

import pytest

from truepath.cli.command import run


@pytest.fixture(scope="module")
def discovered(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("discovered")
    assert run(["discover", str(recorded), "-o", str(folder)]) == 0
    return folder


def test_the_files_of_the_contract_are_written(discovered):
    names = {path.name for path in discovered.iterdir() if path.is_file()}
    assert names == {"discovery.json", "model.json", "report.html"}
    content = json.loads((discovered / "discovery.json").read_text())
    assert content["schema"] == "discovery/1"
    assert content["effects"] == []
    assert content["unnamed"] == []


def test_points_are_predicted_from_the_model(discovered, points, tmp_path):
    out = tmp_path / "predicted.csv"
    model = str(discovered / "model.json")
    order = ["predict", model, "--points", str(points), "-o", str(out)]
    assert run(order) == 0
    header, *rows = out.read_text().splitlines()
    assert header.endswith("dx_um,dy_um,dz_um,ux_um,uy_um,uz_um")
    assert len(rows) == 3


def test_a_model_that_cannot_be_used_is_refused_in_one_line(
    recorded, discovered, tmp_path, capsys
):
    content = json.loads((discovered / "model.json").read_text())
    travel = content["machine"]["axes"]["X"]
    spoilt = {
        "missing.json": None,
        "schema.json": {**content, "schema": "discovery/1"},
        "version.json": {**content, "version": 1.5},
        "travel.json": {
            **content,
            "machine": {
                **content["machine"],
                "axes": {
                    **content["machine"]["axes"],
                    "X": {**travel, "max_mm": travel["max_mm"] + 100.0},
                },
            },
        },
    }
    said = {
        "missing.json": "cannot be read",
        "schema.json": "schema is not that of a result or model",
        "version.json": "version is 1.5",
        "travel.json": "machine.axes",
    }
    for name, text in spoilt.items():
        file = tmp_path / name
        if text is not None:
            file.write_text(json.dumps(text))
        order = ["discover", str(recorded), "-o", str(tmp_path / "out")]
        assert run([*order, "--model", str(file)]) == 2, name
        line = capsys.readouterr().err.strip().splitlines()[-1]
        assert name in line
        assert said[name] in line


def test_a_bundle_without_a_stream_is_refused(bundle, tmp_path, capsys):
    for file in bundle.glob("tracker.*"):
        file.unlink()
    assert run(["discover", str(bundle), "-o", str(tmp_path / "out")]) == 2
    assert "tracker" in capsys.readouterr().err
