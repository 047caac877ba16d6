"""`plan`: a path or points, programs, what is to be expected; `grade`: of any path."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.commanded_file import decode_commanded
from truepath.files.bundle.machine_file import decode_machine
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath_simulators.machine_file import load_machine

LINUXCNC = ("--control", "linuxcnc")
STAND = {"position_mm": [200.0, -1200.0, 0.0]}
BLIND = {"direction": [0, 0, 0], "half_angle_deg": 30}
BOX = {"min_mm": [150, 120, 90], "max_mm": [500, 400, 300]}
FLOOR = {"min_mm": [-1500, -1800, 0], "max_mm": [2000, -600, 0]}
pytestmark = pytest.mark.usefixtures("little_search")
VERIFY = ("--verify", "diagonals", "--verify", "random-points")


@pytest.fixture(scope="module")
def machine(machine_file):
    return decode_machine(machine_file.read_bytes())


@pytest.fixture(scope="module")
def planned(little_search, machine_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("planned")
    workspace = folder / "workspace.json"
    workspace.write_text(json.dumps({"keep_out": [BOX], "tracker": STAND}))
    options = ["-o", str(folder / "out"), "--minutes", "1", "--seed", "5"]
    options += ["--workspace", str(workspace)]
    assert run(["plan", str(machine_file), *options]) == 0
    return folder / "out"


@pytest.fixture
def plan(command, machine_file, tmp_path, keep):
    def make(*options, workspace=None, machine=machine_file):
        words = ["plan", machine, "-o", tmp_path / "out", *LINUXCNC, *options]
        if workspace is not None:
            words += ["--workspace", keep(workspace, "workspace.json")]
        said = command.run(*words).out
        return json.loads((tmp_path / "out" / "plan.json").read_text()), said

    return make


def read_rows(file, machine):
    is_path = file.name == "path.csv"
    return decode_commanded(file.read_bytes(), machine, file.name, is_path=is_path)


@pytest.fixture(scope="module")
def document(planned):
    return json.loads((planned / "plan.json").read_text())


def test_a_plan_fits_its_minutes_and_says_what_it_leaves(planned, document, machine):
    assert (document["schema"], document["mode"]) == ("plan/1", "otf")
    assert document["rows"] == len(read_rows(planned / "path.csv", machine)) > 5
    assert 45.0 < document["duration_s"] <= 60.0
    names = {file.name for file in planned.iterdir() if file.is_file()}
    assert names == {"path.csv", "plan.json", "plan.html"}
    predicted = document["predicted"]
    expanded = predicted["expanded_volumetric_uncertainty_um"]
    assert expanded == pytest.approx(2.0 * predicted["volumetric_uncertainty_um"])
    assert 0.1 < expanded < 50.0
    for symbol, unit in (("EXX", "um"), ("EAX", "urad"), ("C0Y", "urad")):
        assert predicted["errors"][symbol][f"uncertainty_{unit}"] > 0.0
    assert {text[:3] for text in document["unobservable"]} >= {"EAZ", "EBZ", "ECZ"}
    told = [place["expanded_volumetric_uncertainty_um"] for place in document["curve"]]
    assert (np.diff(told) <= 0.0).all()
    assert told[-1] == pytest.approx(expanded)
    assert "<svg" in (planned / "plan.html").read_text()
    for control in list_dialects():
        (program,) = (planned / control).iterdir()
        assert len(read_program(program.read_text(), control).path) == document["rows"]


def test_a_workspace_keeps_the_path_out_of_its_boxes(planned, document, machine):
    assert not document["tracker"]["assumed"]
    path = read_rows(planned / "path.csv", machine)
    share = np.linspace(0.0, 1.0, 300)[:, None, None]
    swept = path.position[:-1] + share * np.diff(path.position, axis=0)
    inside = (swept > BOX["min_mm"]) & (swept < BOX["max_mm"])
    assert not inside.all(axis=-1).any()


def test_points_are_planned_for_standstills(command, machine_file, machine, tmp_path):
    options = ["--mode", "standstill", "--minutes", "0.6", *LINUXCNC]
    said = command.json("plan", machine_file, "-o", tmp_path / "out", *options)
    assert said["rows"] == len(read_rows(tmp_path / "out" / "points.csv", machine)) >= 5
    assert said["duration_s"] <= 36.0
    assert said["tracker"]["assumed"]
    files = (tmp_path / "out").rglob("*")
    assert set(said["files"]) == {str(f) for f in files if f.is_file()}


def test_a_target_is_reached_in_no_more_time_than_it_takes(plan):
    document, _ = plan("--target-um", "5", "--minutes", "0.6", "--feed", "6000")
    name = "volumetric_uncertainty_um"
    assert document["target"] == {name: 5.0, f"expanded_{name}": 10.0, "reached": True}
    assert document["predicted"]["volumetric_uncertainty_um"] <= 5.0
    assert document["duration_s"] < 30.0


def test_several_feeds_tell_the_lags_and_a_target_out_of_reach_is_said(plan):
    feeds = ("--feed", "3000", "--feed", "9000", "--minutes", "1")
    document, said = plan("--target-um", "0.25", *feeds)
    assert "the target of 0.5 µm (k = 2) is out of reach" in said
    lags = document["predicted"]["servo_mismatch"]
    assert set(lags) == {"X", "Y", "Z"}
    assert all(0.0 < lag["uncertainty_ms"] < 0.3 for lag in lags.values())


def test_a_corner_path_is_judged_like_a_plan(plan):
    document, _ = plan("--corner-path", "--perpendicular-only", "--feed", "15000")
    assert document["corner_path"]
    assert document["predicted"]["expanded_volumetric_uncertainty_um"] > 2.0
    assert any("not corner to corner" in text for text in document["unobservable"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--mode dancing --minutes 1", "mode is 'dancing'; it is otf or standstill"),
        ("--corner-path --minutes 2", "leave minutes and target out"),
        ("--minutes 0.1 --feed 60", "give more time or a higher feed"),
        ("--control abacus --minutes 0.2", "abacus"),
        ("--workspace nowhere.json --minutes 1", "nowhere.json: cannot be read"),
    ],
)
def test_a_plan_that_cannot_be_is_said(command, machine_file, tmp_path, options, said):
    out = tmp_path / "out"
    assert said in command.refuse("plan", machine_file, "-o", out, *options.split())
    assert not list(out.rglob("*.csv"))


def box_to(*place):
    return {"min_mm": [0, 0, 0], "max_mm": place}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"schema": "workspace/9"}, "schema is"),
        ({"keep_out": [{"min_mm": [0, 0, 0]}]}, "keep_out[0].max_mm"),
        ({"keep_out": [box_to(1, 0, 1)]}, "[0].max_mm is [1, 0, 1]; each must exceed"),
        ({"blocks_sight": [box_to(1, 1, 1)]}, "state tracker.position_mm"),
        ({"tracker": {"nearest_mm": 300}}, "tracker.position_mm is missing"),
        ({"tracker": {"areas": [box_to(1, -1, 0)]}}, "areas[0].max_mm lies below min"),
        ({"tracker": {"areas": [FLOOR]}, "reflector": BLIND}, "direction has no len"),
    ],
)
def test_a_bad_workspace_is_named(command, machine_file, tmp_path, keep, content, said):
    words = ["plan", machine_file, "-o", tmp_path / "out", "--workspace"]
    error = command.refuse(*words, keep(content, "workspace.json"))
    assert "workspace.json" in error
    assert said in error


def test_a_plan_chooses_the_place_and_says_what_more_stations_bring(plan, tmp_path):
    workspace = {"schema": "workspace/1", "tracker": {"areas": [FLOOR]}}
    document, said = plan("--minutes", "0.6", workspace=workspace)
    tracker, stations = document["tracker"], document["stations"]
    assert tracker["chosen"]
    assert not tracker["assumed"]
    place = np.array(tracker["position_mm"])
    assert ((place >= FLOOR["min_mm"]) & (place <= FLOOR["max_mm"])).all()
    assert stations["best"]["position_mm"] == tracker["position_mm"]
    assert [option["count"] for option in stations["options"]] == [1, 2, 3]
    predicted_um = document["predicted"]["volumetric_uncertainty_um"]
    # The scale of the air is in what the result will state, and no place takes it away.
    random_um = stations["options"][0]["random_um"]
    assert random_um < predicted_um < 1.2 * random_um
    assert stations["recommended"] == 1
    assert all(f"tracker: {one}" in said for one in stations["statement"])
    assert "one station is enough" in (tmp_path / "out" / "plan.html").read_text()


def test_a_plan_says_what_the_tracker_may_be_off_by_and_the_remedy(plan, keep):
    content = load_machine("demo")
    del content["tracker"]["specification"]  # a typical one
    document, said = plan("--minutes", "0.5", machine=keep(content, "machine.json"))
    statements = document["predicted"]["tracker_errors"]["statement"]
    assert len(statements) == 3
    assert all(f"tracker: {statement}" in said for statement in statements)


def test_several_stations_have_a_folder_each(plan, machine, tmp_path):
    nests = [{"min_mm": p, "max_mm": p} for p in ([250, -700, 0], [1100, 100, 50])]
    workspace = {"schema": "workspace/1", "tracker": {"areas": nests}}
    minutes = ("--minutes", "0.6", "--feed", "6000")
    document, said = plan(*minutes, "--stations", "2", workspace=workspace)
    for number, station in enumerate(document["at_stations"], start=1):
        rows = tmp_path / "out" / f"station-{number}" / "path.csv"
        assert len(read_rows(rows, machine)) == station["rows"]
        assert f"station-{number}/linuxcnc" in "".join(document["files"])
        assert f"station-{number}: tracker at (" in said


def test_verifying_has_a_program_per_control(command, machine_file, machine, tmp_path):
    order = ["plan", machine_file, "-o", tmp_path / "out", *VERIFY]
    said = command.json(*order)
    points = read_rows(tmp_path / "out" / "points.csv", machine)
    files = [tmp_path / "out" / name for name in said["files"]]
    for control in list_dialects():
        (program,) = (file for file in files if file.parent.name == control)
        motion = read_program(program.read_text(), control)
        np.testing.assert_allclose(motion.position, points.position, atol=6e-4)
        np.testing.assert_allclose(motion.dwell_s, points.dwell_s)
    named = command.json(*order, *LINUXCNC)["files"]
    assert {(tmp_path / name).parent.name for name in named} == {"out", "linuxcnc"}


def test_circles_have_programs_for_arcs(command, machine_file, machine, tmp_path):
    words = ["plan", machine_file, "--verify", "circles-in-motion", "-o"]
    said = command.json(*words, tmp_path / "out")
    path = read_rows(tmp_path / "out" / "path.csv", machine)
    names = {file.rpartition("/")[2] for file in said["files"]}
    assert {"path.csv", "plan.json"} < names
    programs = {p.parent.name: p for p in (tmp_path / "out").glob("*/*")}
    assert set(programs) == {"fanuc", "heidenhain", "siemens-840d"}
    for control, program in programs.items():
        driven = read_program(program.read_text(), control).path
        assert [arc is None for arc in driven.arc] == [arc is None for arc in path.arc]
    refused = command.refuse(*words, tmp_path / "no", *LINUXCNC)
    assert "the path has arcs" in refused
    assert "plan circles in place" in refused


@pytest.fixture
def files(recorded):
    return recorded / "machine.json", recorded / "path.csv"


def test_paths_and_points_are_graded_in_numbers_and_words(command, files, tmp_path):
    order = ["grade", *files, "--tracker=-900,0,200"]
    said = command.json(*order)
    assert said["schema"] == "grade/1"
    assert said["verdict"] in ("good", "usable", "poor")
    assert said["tracker"]["position_mm"] == [-900.0, 0.0, 200.0]
    assert said["tracker"]["assumed"] is False
    assert all(s[0] == "E" for s in said["unobservable"])
    assert command.json(*order, "--perpendicular-only")["number"] > said["number"]
    said = command.run("grade", *files).out
    assert said.startswith("grade of the set-up: 0.")
    assert "worst of four usual places" in said
    assert "cannot be seen: EBZ (turn of Z about Y) is not distinguishable from" in said
    points = tmp_path / "points.csv"
    points.write_text("x_mm,y_mm,z_mm,dwell_s\n10,10,10,1\n400,300,200,1\n")
    assert command.json("grade", files[0], points)["verdict"] == "poor"


@pytest.mark.parametrize("place", ["1500,0", "here", "1,2,nan", "1,2,3,4"])
def test_half_a_place_is_refused(command, files, place):
    said = command.refuse("grade", *files, f"--tracker={place}")
    assert f"--tracker {place}: not a place; write X,Y,Z in mm" in said
