"""A calibration live on LinuxCNC leaves little of the error, and says how much."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from truepath.simulators.linuxcnc.rig import explain_absence

ABSENT = explain_absence()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none"),
]


@pytest.fixture
def live(monkeypatch):
    folder = str(Path(__file__).resolve().parents[2] / "validation")
    monkeypatch.syspath_prepend(folder)
    before = set(sys.modules)
    yield importlib.import_module("live_linuxcnc")
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(folder):
            del sys.modules[name]


@pytest.mark.parametrize(
    ("case", "lines", "factor"),
    [("THREE_AXES", 24, 15.0), ("OVER_MODBUS", 24, 15.0), ("FIVE_AXES", 48, 15.0)],
)
def test_linuxcnc_drives_and_the_error_is_found(live, tmp_path, case, lines, factor):
    shorter = replace(getattr(live, case), lines=lines)
    outcome = live.run_case(shorter, 7, tmp_path)
    assert outcome.lost == 0
    assert outcome.factor > factor
    assert outcome.inside > 0.85
