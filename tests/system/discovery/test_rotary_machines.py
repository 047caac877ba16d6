"""Machines with rotary axes: arcs hide nothing and make nothing up."""

import pytest

from recorded import record_path
from results_fixtures import shorten
from truepath.discovery.discover import discover, extend_model
from truepath.files.bundle.machine_file import machine_from_json
from truepath.planning.default_path import default_path
from truepath_simulators.hidden import drives
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds.synthetic import Setting

pytestmark = pytest.mark.timeout(180)

# A small machine whose head turns, with two targets on it.
LINEAR = {"type": "linear", "min_mm": 0.0, "max_mm": 200.0}
ROTARY = {"type": "rotary", "min_deg": 0.0, "max_deg": 360.0}
OFFSETS_MM = {"T1": [60.0, 0.0, -120.0], "T2": [-20.0, 70.0, -180.0]}
HEAD = {"schema": "machine/1", "name": "small", "kinematic_chain": "w-b-X-Y-Z-C-t"}
HEAD |= {
    "axes": {**dict.fromkeys("XYZ", LINEAR), "C": {**ROTARY, "origin_mm": [3, -5, 0]}},
    "targets": {n: {"on": "tool", "offset_mm": at} for n, at in OFFSETS_MM.items()},
    "tracker": {"stands_on": "workpiece", "rate_hz": 100},
}
GEAR, SAG = (
    drives.GearCyclic("C", 6.0, 40.0, 1.0),
    drives.SwivelSag("Y", "C", "Z", 8.0, 0.5),
)


def drive(content, hidden, lines=None, reference=None):
    path = default_path(machine_from_json(content), 6000.0, lines=lines, seed=3)
    run, _ = record_path(content, path, setting=Setting(hidden=hidden))
    return discover([run], reference)


@pytest.fixture(scope="module")
def plain():
    return drive(HEAD, (), 28)


def require_named(found, hidden, label):
    (finding,) = found.findings
    assert finding.candidate.label == label
    for name, true in hidden.parameters(None).items():
        told = finding.parameters[name]
        assert abs(told.value - true) < 4.0 * told.uncertainty


@pytest.mark.long
def test_a_scale_off_centre_since_the_model_was_made_is_named_and_no_other(plain):
    hidden = drives.RotaryEccentricity("C", 40.0, 1.0)
    model = extend_model(plain)
    found = drive(HEAD, (hidden,), 28, model)
    require_named(found, hidden, "rotary-eccentricity C")
    assert not drive(HEAD, (), 28, model).findings


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        pytest.param(GEAR, "gear-cyclic C", id="gear"),
        pytest.param(SAG, "swivel-sag Y C Z", id="sag", marks=pytest.mark.long),
    ],
)
def test_a_gears_error_or_a_sag_that_turns_is_named_where_it_is(plain, hidden, said):
    assert not plain.findings
    require_named(drive(HEAD, (hidden,), 28), hidden, said)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        ("trunnion", drives.Backlash("X", 8.0)),
        ("trunnion", None),
        ("head-table", None),
        ("head-table", drives.ServoMismatch("Y", 0.3)),
        ("trunnion", drives.TurningBacklash("C", 60.0)),
        ("head-table", drives.GearCyclic("C", 5.0, 25.0, 1.0)),
    ],
)
def test_what_is_hidden_in_a_machine_with_rotary_axes_is_named_alone(name, hidden):
    content = shorten(load_machine(name))
    content["tracker"]["stands_on"] = "base"
    found = drive(content, () if hidden is None else (hidden,))
    wanted = [] if hidden is None else [f"{hidden.name} {hidden.axis}"]
    assert [f.candidate.label for f in found.findings] == wanted
    assert found.gap.after_um < 1.05 * found.gap.noise_floor_um
