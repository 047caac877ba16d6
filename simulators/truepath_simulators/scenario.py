"""Bundled machines by name, or any machine.json by its path."""

from __future__ import annotations

import json
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from truepath_simulators.errors import SimulatorError

BUNDLED: Traversable = resources.files("truepath_simulators") / "scenarios"


def list_machines() -> tuple[str, ...]:
    """Names of the machines that are bundled with the simulators."""
    return tuple(
        sorted(
            entry.name.removesuffix(".json")
            for entry in BUNDLED.iterdir()
            if entry.name.endswith(".json")
        )
    )


def load_machine(name: str | Path) -> dict[str, Any]:
    """Content of a bundled machine or of a machine.json.

    Raises SimulatorError naming the file, or the bundled machines.
    """
    if str(name) in list_machines():
        return json.loads((BUNDLED / f"{name}.json").read_text(encoding="utf-8"))
    try:
        content = json.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        known = ", ".join(list_machines())
        raise SimulatorError(
            f"{name}: {error.strerror}; a path to a machine.json, or one of {known}"
        ) from error
    except ValueError as error:
        raise SimulatorError(f"{name}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise SimulatorError(f"{name}: not a JSON object")
    return content
