"""The NC program that a machine executed, as the path of a bundle."""

from __future__ import annotations

from pathlib import Path as FilePath

from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError, PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.nc_programs.programmed_motion import ProgrammedMotion
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath.motion.workspace import check_travel
from truepath.plugins import PluginFailed
from truepath_drivers.interfaces.records import Path


def read_commanded_program(
    file: FilePath, machine: Machine, dialect: str = ""
) -> tuple[Path, str]:
    """The path of a measuring program, and the dialect that parsed it.

    dialect : of the control; if empty, the one that parses the whole program

    Raises BundleError naming the line, or the dialects that parse it differently.
    """
    text = read_whole(file).decode("utf-8", "replace")
    motions, refusals = _read_by(text, [dialect] if dialect else list_dialects())
    readings = {
        (motion.checksum, *motion.feed_mm_min, *motion.dwell_s)
        for motion in motions.values()
    }
    if not motions:
        raise BundleError(
            f"is no measuring program: {'; '.join(refusals)[:300]}",
            file=str(file),
            remedy="give path.csv, or name the control by --dialect",
        )
    if len(readings) > 1:
        raise BundleError(
            f"is read differently as {', '.join(motions)}",
            file=str(file),
            remedy="name the control by --dialect",
        )
    name, motion = next(iter(motions.items()))
    _require_unchanged(motion, file)
    check_travel(machine, motion.path)
    return motion.path, name


def _read_by(
    text: str, dialects: tuple[str, ...] | list[str]
) -> tuple[dict[str, ProgrammedMotion], list[str]]:
    motions: dict[str, ProgrammedMotion] = {}
    refusals: list[str] = []
    for name in dialects:
        try:
            motion = read_program(text, name)
        except (PlanningError, PluginFailed) as error:
            refusals.append(f"{name}: {error}")
        else:
            if len(motion) > 1:
                motions[name] = motion
    return motions, refusals


def _require_unchanged(motion: ProgrammedMotion, file: FilePath) -> None:
    if not motion.exact_stop.all():
        problem = "has motions without an exact stop"
    elif motion.stated_checksum not in ("", motion.checksum):
        problem = "states the checksum of another path: positions were changed"
    else:
        return
    remedy = "give the program that the machine ran, as it was written"
    raise BundleError(problem, file=str(file), remedy=remedy)
