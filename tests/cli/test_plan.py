"""`truepath plan`: a path or points, NC programs, and what is to be expected."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.commanded_file import decode_commanded
from truepath.files.bundle.machine_file import decode_machine
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath_simulators.scenario import load_machine


@pytest.fixture(scope="session")
def machine_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("machine") / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    return file


@pytest.fixture(scope="session")
def planned(machine_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("planned")
    options = ["-o", str(folder), "--minutes", "1", "--seed", "5"]
    assert run(["plan", str(machine_file), *options]) == 0
    return folder


def test_a_plan_is_a_path_that_fits_into_the_minutes(planned, machine_file):
    machine = decode_machine(machine_file.read_bytes())
    path = decode_commanded(
        (planned / "path.csv").read_bytes(), machine, "path.csv", is_path=True
    )
    document = json.loads((planned / "plan.json").read_text())
    assert document["schema"] == "plan/1"
    assert document["mode"] == "otf"
    assert document["rows"] == len(path) > 5
    assert 45.0 < document["duration_s"] <= 60.0
    assert {file.name for file in planned.iterdir() if file.is_file()} == {
        "path.csv",
        "plan.json",
        "plan.html",
    }


def test_a_plan_says_what_it_will_leave_and_what_stays_unseen(planned):
    document = json.loads((planned / "plan.json").read_text())
    predicted = document["predicted"]
    expanded = predicted["expanded_volumetric_uncertainty_um"]
    assert expanded == pytest.approx(2.0 * predicted["volumetric_uncertainty_um"])
    assert 0.1 < expanded < 50.0
    assert predicted["errors"]["EXX"]["uncertainty_um"] > 0.0
    assert predicted["errors"]["EAX"]["uncertainty_urad"] > 0.0
    assert predicted["errors"]["C0Y"]["uncertainty_urad"] > 0.0
    assert {text[:3] for text in document["unobservable"]} >= {"EAZ", "EBZ", "ECZ"}
    assert document["tracker"]["assumed"]
    told = [place["expanded_volumetric_uncertainty_um"] for place in document["curve"]]
    assert (np.diff(told) <= 0.0).all()
    assert told[-1] == pytest.approx(expanded)
    assert "<svg" in (planned / "plan.html").read_text()


@pytest.mark.parametrize("control", list_dialects())
def test_every_control_gets_a_program_of_the_same_rows(planned, control):
    (program,) = (planned / control).iterdir()
    motion = read_program(program.read_text(), control)
    rows = json.loads((planned / "plan.json").read_text())["rows"]
    assert len(motion.path) == rows


def test_points_are_planned_for_standstills(machine_file, tmp_path, summary):
    options = ["--mode", "standstill", "--minutes", "1", "--control", "linuxcnc"]
    arguments = ["plan", str(machine_file), "-o", str(tmp_path), *options, "--json"]
    assert run(arguments) == 0
    machine = decode_machine(machine_file.read_bytes())
    points = decode_commanded(
        (tmp_path / "points.csv").read_bytes(), machine, "points.csv", is_path=False
    )
    said = summary()
    assert said["rows"] == len(points) >= 8
    assert said["duration_s"] <= 60.0
    assert set(said["files"]) == {str(f) for f in tmp_path.rglob("*") if f.is_file()}


def test_a_target_is_reached_in_no_more_time_than_it_takes(
    machine_file, tmp_path, summary
):
    options = ["--target-um", "2.5", "--minutes", "2"]
    options += ["--control", "linuxcnc", "--json"]
    assert run(["plan", str(machine_file), "-o", str(tmp_path), *options]) == 0
    said = summary()
    assert said["target"] == {
        "volumetric_uncertainty_um": 2.5,
        "expanded_volumetric_uncertainty_um": 5.0,
        "reached": True,
    }
    assert said["predicted"]["volumetric_uncertainty_um"] <= 2.5
    assert said["duration_s"] < 120.0


def test_a_target_out_of_reach_in_the_minutes_says_how_far_they_come(
    machine_file, tmp_path, capsys
):
    options = ["--target-um", "0.25", "--minutes", "0.6", "--control", "linuxcnc"]
    assert run(["plan", str(machine_file), "-o", str(tmp_path), *options]) == 0
    assert "the target of 0.25 µm (k = 1) is out of reach" in capsys.readouterr().out


def test_several_feeds_say_how_well_the_lags_of_the_axes_will_be_told(
    machine_file, tmp_path, summary
):
    feeds = ["--feed", "3000", "--feed", "9000", "--minutes", "1"]
    arguments = ["-o", str(tmp_path), *feeds, "--control", "linuxcnc", "--json"]
    assert run(["plan", str(machine_file), *arguments]) == 0
    lags = summary()["predicted"]["servo_mismatch"]
    assert set(lags) == {"X", "Y", "Z"}
    assert all(0.0 < lag["uncertainty_ms"] < 0.3 for lag in lags.values())


def test_a_corner_path_is_judged_like_a_plan(machine_file, tmp_path, summary):
    options = ["--corner-path", "--perpendicular-only", "--control", "linuxcnc"]
    arguments = ["plan", str(machine_file), "-o", str(tmp_path), *options, "--json"]
    assert run(arguments) == 0
    said = summary()
    assert said["corner_path"]
    assert said["predicted"]["expanded_volumetric_uncertainty_um"] > 2.0
    assert any("not corner to corner" in text for text in said["unobservable"])


def test_a_workspace_keeps_the_path_out_of_its_boxes(machine_file, tmp_path, summary):
    machine = decode_machine(machine_file.read_bytes())
    low = np.array([axis.low for axis in machine.axes])
    high = np.array([axis.high for axis in machine.axes])
    box = {"min_mm": (0.7 * low + 0.3 * high).tolist(), "max_mm": high.tolist()}
    stand = {"position_mm": [200.0, -1200.0, 0.0]}
    workspace = tmp_path / "workspace.json"
    workspace.write_text(json.dumps({"keep_out": [box], "tracker": stand}))
    out = tmp_path / "out"
    options = ["--minutes", "0.5", "--workspace", str(workspace), "--json"]
    assert run(["plan", str(machine_file), "-o", str(out), *options]) == 0
    assert not summary()["tracker"]["assumed"]
    path = decode_commanded(
        (out / "path.csv").read_bytes(), machine, "path.csv", is_path=True
    )
    share = np.linspace(0.0, 1.0, 300)[:, None, None]
    swept = path.position[:-1] + share * np.diff(path.position, axis=0)
    inside = (swept > np.array(box["min_mm"])) & (swept < np.array(box["max_mm"]))
    assert not inside.all(axis=-1).any()


def test_a_target_on_the_axis_that_turns_it_is_refused(tmp_path, capsys):
    content = load_machine("trunnion")
    content["kinematic_chain"] = "w-C-b-X-Y-Z-t"
    del content["axes"]["A"]
    place = [*content["axes"]["C"]["origin_mm"][:2], 0.0]
    content["targets"] = {"W": {"on": "workpiece", "offset_mm": place}}
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(content))
    assert run(["plan", str(file), "-o", str(tmp_path / "out")]) == 2
    assert "W hardly moves where the tracker stands" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--mode", "dancing"], "mode is 'dancing'; it is otf or standstill"),
        (["--corner-path", "--minutes", "2"], "leave minutes and target out"),
        (["--minutes", "0.1", "--feed", "60"], "give more time or a higher feed"),
        (["--control", "abacus"], "abacus"),
        (["--workspace", "nowhere.json"], "nowhere.json: cannot be read"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_in_one_line(
    machine_file, tmp_path, capsys, options, said
):
    out = tmp_path / "out"
    if "--minutes" not in options:
        options = [*options, "--minutes", "0.3"]
    if "--corner-path" in options:
        options = [o for o in options if o != "0.3"]
    assert run(["plan", str(machine_file), "-o", str(out), *options]) == 2
    error = capsys.readouterr().err.splitlines()
    assert said in error[-1]
    assert not list(out.rglob("*.csv"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"schema": "workspace/9"}, "schema is"),
        ({"keep_out": [{"min_mm": [0, 0, 0]}]}, "keep_out[0].max_mm"),
        (
            {"keep_out": [{"min_mm": [0, 0, 0], "max_mm": [1, 0, 1]}]},
            "keep_out[0].max_mm is [1, 0, 1]; each must exceed min_mm",
        ),
        (
            {"blocks_sight": [{"min_mm": [0, 0, 0], "max_mm": [1, 1, 1]}]},
            "state tracker.position_mm",
        ),
        ({"tracker": {"nearest_mm": 1}}, "tracker.position_mm"),
    ],
)
def test_a_bad_workspace_is_named_with_its_key(
    machine_file, tmp_path, capsys, content, said
):
    workspace = tmp_path / "workspace.json"
    workspace.write_text(json.dumps(content))
    options = ["-o", str(tmp_path / "out"), "--workspace", str(workspace)]
    assert run(["plan", str(machine_file), *options]) == 2
    error = capsys.readouterr().err
    assert "workspace.json" in error
    assert said in error


FLOOR = {"min_mm": [-1500, -1800, 0], "max_mm": [2000, -600, 0]}


def test_a_plan_chooses_the_place_and_says_what_more_stations_bring(
    machine_file, tmp_path, capsys
):
    workspace = tmp_path / "workspace.json"
    workspace.write_text(
        json.dumps({"schema": "workspace/1", "tracker": {"areas": [FLOOR]}})
    )
    arguments = ["--minutes", "1", "--control", "linuxcnc"]
    arguments += ["-o", str(tmp_path / "out"), "--workspace", str(workspace)]
    assert run(["plan", str(machine_file), *arguments]) == 0
    document = json.loads((tmp_path / "out" / "plan.json").read_text())
    tracker, stations = document["tracker"], document["stations"]
    assert tracker["chosen"]
    assert not tracker["assumed"]
    place = np.array(tracker["position_mm"])
    assert (place >= FLOOR["min_mm"]).all()
    assert (place <= FLOOR["max_mm"]).all()
    assert stations["best"]["position_mm"] == tracker["position_mm"]
    assert [option["count"] for option in stations["options"]] == [1, 2, 3]
    predicted_um = document["predicted"]["volumetric_uncertainty_um"]
    assert stations["options"][0]["random_um"] == pytest.approx(predicted_um)
    assert stations["recommended"] == 1
    said = capsys.readouterr().out
    page = (tmp_path / "out" / "plan.html").read_text()
    for statement in stations["statement"]:
        assert f"tracker: {statement}" in said
    assert "one station is enough" in page


def test_several_stations_have_a_folder_each(machine_file, tmp_path, capsys):
    nests = [{"min_mm": p, "max_mm": p} for p in ([250, -700, 0], [1100, 100, 50])]
    workspace = tmp_path / "workspace.json"
    workspace.write_text(
        json.dumps({"schema": "workspace/1", "tracker": {"areas": nests}})
    )
    arguments = ["--minutes", "0.6", "--feed", "6000", "--control", "linuxcnc"]
    arguments += ["--stations", "2", "--workspace", str(workspace)]
    folder = tmp_path / "out"
    assert run(["plan", str(machine_file), "-o", str(folder), *arguments]) == 0
    document = json.loads((folder / "plan.json").read_text())
    machine, said = decode_machine(machine_file.read_bytes()), capsys.readouterr().out
    for number, station in enumerate(document["at_stations"], start=1):
        rows = folder / f"station-{number}" / "path.csv"
        path = decode_commanded(rows.read_bytes(), machine, "path.csv", is_path=True)
        assert len(path) == station["rows"]
        assert f"station-{number}/linuxcnc" in "".join(document["files"])
        assert f"station-{number}: tracker at (" in said


@pytest.mark.parametrize(
    ("workspace", "problem"),
    [
        ({"tracker": {"nearest_mm": 300}}, "tracker.position_mm is missing"),
        (
            {"tracker": {"areas": [{"min_mm": [0, 0, 0], "max_mm": [1, -1, 0]}]}},
            "tracker.areas[0].max_mm lies below min_mm",
        ),
        (
            {
                "tracker": {"areas": [FLOOR]},
                "reflector": {"direction": [0, 0, 0], "half_angle_deg": 30},
            },
            "reflector.direction has no length",
        ),
    ],
)
def test_what_is_wrong_with_the_tracker_is_named(
    machine_file, tmp_path, capsys, workspace, problem
):
    file = tmp_path / "workspace.json"
    file.write_text(json.dumps({"schema": "workspace/1", **workspace}))
    arguments = ["plan", str(machine_file), "-o", str(tmp_path), "--workspace"]
    assert run([*arguments, str(file)]) == 2
    assert f"workspace.json: {problem}" in capsys.readouterr().err
