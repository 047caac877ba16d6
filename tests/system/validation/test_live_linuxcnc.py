"""A calibration live on LinuxCNC leaves little of the error, and says how much."""

import json
from dataclasses import replace

import pytest

from truepath.motion.paths import verification_kinds, verification_points
from truepath_simulators.linuxcnc.rig import explain_absence

ABSENT = explain_absence()
NEEDED = pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")
pytestmark = [pytest.mark.long, NEEDED]


@pytest.fixture
def live(validation):
    return validation("live_linuxcnc")


@pytest.mark.parametrize(
    ("case", "lines"), [("THREE_AXES", 24), ("OVER_MODBUS", 24), ("FIVE_AXES", 48)]
)
def test_linuxcnc_drives_and_the_error_is_found(live, tmp_path, case, lines):
    shorter = replace(getattr(live, case), lines=lines)
    outcome = live.run_case(shorter, 7, tmp_path)
    assert outcome.lost == 0
    assert outcome.factor > 15.0
    assert outcome.inside > 0.85


def test_tables_that_linuxcnc_loads_leave_what_was_stated(live, tmp_path):
    case, seed = replace(live.THREE_AXES, lines=24), 11
    content = live.load_machine(case.name)
    with live.live_rig(content, seed, case) as rig:
        order = live.make_order(content, case.lines, seed, tmp_path / "found.sqlite")
        found = live.calibrate(rig, order, tmp_path, 600.0)
    assert found.factor > 15.0
    result = tmp_path / "result.json"
    live.run("export", result, "--format", "linuxcnc", "-o", tmp_path / "comp")
    files = {axis: tmp_path / f"comp-{axis}.tbl" for axis in content["axes"]}
    tables = {axis: file.read_text() for axis, file in files.items()}
    with live.live_rig(content, seed, case, tables) as rig:
        kinds = [verification_kinds.VerificationKind.RANDOM_POINTS]
        points = verification_points.make_verification_points(order.machine, kinds, 12)
        file = str(tmp_path / "left.sqlite")
        driven = replace(order, run_name="left", run_file=file, commanded=points)
        closed = live.measure(rig, driven, 600.0)
    assert closed.outcome == "finished"
    named = [word for file in files.values() for word in ("--compensation", file)]
    options = ["--format", "linuxcnc", *named, "-o", tmp_path / "proof"]
    live.run("verify", result, file, *options)
    proof = json.loads((tmp_path / "proof" / "verification.json").read_text())
    assert proof["agreement"]["consistent"]
    assert proof["difference_um"]["mean"]["within"]
    left_um = proof["volumetric_error_um"]["measured"]["mean"]
    assert left_um < 0.8 * found.before_um  # positioning alone is carried
