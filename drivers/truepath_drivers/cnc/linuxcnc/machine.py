"""Axes and travel of a LinuxCNC machine, from its INI file or from an option."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from truepath_drivers.interfaces.errors import Refused

_AXES = "XYZABC"
_WORKAREA = 1e6  # LinuxCNC's own limit where none is named


@dataclass(frozen=True, slots=True)
class LinuxCncAxes:
    """The axes of a machine.

    joints : number of the joint that gives the position of each axis
    joint_count : joints that have to be homed
    has_compensation : whether the INI file gives a joint a table or a backlash to
        correct; None without an INI file
    """

    name: str
    axes: tuple[str, ...]
    travel: tuple[tuple[float, float], ...]
    joints: tuple[int, ...]
    joint_count: int
    has_compensation: bool | None = None


def parse_travel(text: str) -> LinuxCncAxes:
    """Axes of an option `X -10 510, Y -10 410`, mm or deg; joints in this order."""
    names: list[str] = []
    travel: list[tuple[float, float]] = []
    for part in text.split(","):
        words = part.split()
        if len(words) != 3 or words[0].upper() not in _AXES:
            raise ValueError(
                f"option travel: {part.strip()!r} is not an axis with its lowest and "
                "highest position, such as 'X 0 500'"
            )
        names.append(words[0].upper())
        travel.append((float(words[1]), float(words[2])))
    count = len(names)
    joints = tuple(range(count))
    return LinuxCncAxes("", tuple(names), tuple(travel), joints, count)


def read_ini(file: Path) -> LinuxCncAxes:
    """Axes of an INI file. Raises Refused if it cannot be used."""
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise Refused(
            f"{file} cannot be read ({error.strerror}); name a copy of LinuxCNC's INI "
            "file as ini_file, or give travel = 'X 0 500, Y 0 400, Z -300 0'"
        ) from error
    sections = _parse_sections(text)
    if sections["TRAJ"].get("LINEAR_UNITS", "mm").lower() not in ("mm", "metric"):
        raise Refused(f"{file}: LINEAR_UNITS is not mm; this driver drives in mm")
    letters = _list_joints(sections)
    axes = tuple(dict.fromkeys(letters))
    if not axes:
        raise Refused(f"{file} names no axes; give the option travel")
    return LinuxCncAxes(
        sections["EMC"].get("MACHINE", ""),
        axes,
        tuple(_read_travel(sections, axis, letters) for axis in axes),
        tuple(letters.index(axis) for axis in axes),
        len(letters),
        any(_has_compensation(sections[f"JOINT_{n}"]) for n in range(len(letters))),
    )


def _has_compensation(joint: Mapping[str, str]) -> bool:
    """LinuxCNC always corrects a joint that has a table or a backlash."""
    return "COMP_FILE" in joint or float(joint.get("BACKLASH", 0.0)) != 0.0


def _parse_sections(text: str) -> Mapping[str, dict[str, str]]:
    """Only the first value of each entry; an INI file of LinuxCNC repeats entries."""
    sections: defaultdict[str, dict[str, str]] = defaultdict(dict)
    section = ""
    for line in text.splitlines():
        line = line.strip()
        if found := re.fullmatch(r"\[(\w+)\].*", line):
            section = found.group(1).upper()
        elif "=" in line and not line.startswith(("#", ";")):
            name, _, value = line.partition("=")
            value = re.split(r"\s[#;]", value.strip(), maxsplit=1)[0].strip()
            sections[section].setdefault(name.strip().upper(), value)
    return sections


def _list_joints(sections: Mapping[str, dict[str, str]]) -> list[str]:
    kinematics = sections["KINS"].get("KINEMATICS", "")
    found = re.search(r"coordinates\s*=\s*(\w+)", kinematics, re.IGNORECASE)
    words = found.group(1) if found else sections["TRAJ"].get("COORDINATES", "")
    return [letter for letter in words.upper() if letter in _AXES]


def _read_travel(
    sections: Mapping[str, dict[str, str]], axis: str, letters: list[str]
) -> tuple[float, float]:
    joint = sections[f"JOINT_{letters.index(axis)}"]
    both = (sections[f"AXIS_{axis}"], joint)
    low = max(float(entry.get("MIN_LIMIT", -_WORKAREA)) for entry in both)
    high = min(float(entry.get("MAX_LIMIT", _WORKAREA)) for entry in both)
    return low, high
