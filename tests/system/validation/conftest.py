"""The scripts of `validation/`, which are no package."""

import importlib
import sys
from pathlib import Path

import pytest

FOLDER = str(Path(__file__).resolve().parents[3] / "validation")


@pytest.fixture(scope="module")
def validation():
    before = set(sys.modules)
    sys.path.insert(0, FOLDER)
    yield importlib.import_module
    sys.path.remove(FOLDER)
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(FOLDER):
            del sys.modules[name]


@pytest.fixture
def perfect_trackers(validation, monkeypatch):
    """For what a tracker's own errors would hide."""
    for name in ("recordings", "large_machines"):
        monkeypatch.setattr(validation(name), "draw_specification", lambda seed: {})
