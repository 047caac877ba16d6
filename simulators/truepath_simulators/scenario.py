"""Bundled machines by name, or any machine.json by its path."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

from truepath_simulators.errors import SimulatorError


def list_machines() -> tuple[str, ...]:
    """Names of the machines that are bundled with the simulators."""
    folder = resources.files("truepath_simulators") / "scenarios"
    return tuple(
        sorted(
            entry.name.removesuffix(".json")
            for entry in folder.iterdir()
            if entry.name.endswith(".json")
        )
    )


def load_machine(name: str | Path) -> dict[str, Any]:
    """Content of a bundled machine or of a machine.json.

    Raises SimulatorError naming the file, or the bundled machines.
    """
    if str(name) in list_machines():
        file = resources.files("truepath_simulators") / "scenarios" / f"{name}.json"
        return json.loads(file.read_text(encoding="utf-8"))
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
