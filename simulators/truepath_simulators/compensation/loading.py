"""Compensation files of any simulated form, distinguished by their content."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from truepath_simulators.compensation.correction import (
    BACKLASH_READINGS,
    ChainedCorrection,
    Correction,
    ReversedCorrection,
    Rules,
    TableCorrection,
    Term,
)
from truepath_simulators.compensation.fanuc_tables import read_fanuc
from truepath_simulators.compensation.heidenhain_tables import read_heidenhain
from truepath_simulators.compensation.isg_tables import read_etalon, read_isg
from truepath_simulators.compensation.linuxcnc import (
    is_kinematics,
    read_kinematics,
    read_linuxcnc,
)
from truepath_simulators.compensation.plain_tables import COLUMNS, read_plain
from truepath_simulators.compensation.siemens import (
    is_swivel,
    read_siemens,
    read_swivel,
)
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

_SIGNS = {
    "plain": re.compile(
        rf"\A(?:#.*\n)*{','.join(COLUMNS)}|\A{{\s*"
        r'"schema": "compensation-tables/1"'
    ),
    "siemens": re.compile(
        r"\A%_N_\w+_INI|^\$A[AN]_(?:ENC_COMP|CEC)|\$(?i:TC_CARR)\d+\s*\[",
        re.M,
    ),
    "heidenhain": re.compile(r"\ABEGIN .*\n(?:.*\n)*\[END\]"),
    "fanuc": re.compile(r"\A%\s+N\d+(?:A\d+)?P"),
    "etalon": re.compile(r"^\s*\[\w+\]\s*\n\s*(?:VALUE|Gridpoints)\s*=", re.M),
    "isg": re.compile(r"^\s*(?:[XYZABC]\s+)?[XYZABC]\s+E[XYZABC][XYZABC]\b", re.M),
    "linuxcnc": re.compile(
        r"\A\s*[-+\d.]+[ \t]+[-+\d.]+[ \t]+[-+\d.]+\s*$|^setp xyz[ab]c-trt-kins", re.M
    ),
}
_KINEMATICS: Mapping[str, tuple[Callable[[str], bool], Callable[..., Correction]]] = {
    "linuxcnc": (is_kinematics, read_kinematics),
    "siemens": (is_swivel, read_swivel),
}
_OF_THE_VOLUME = {"isg": read_isg, "etalon": read_etalon, "plain": read_plain}


@dataclass(frozen=True, slots=True)
class LoadedTables:
    """Files loaded into a controller.

    files : text by name, of one form; rules : its readings
    """

    files: Mapping[str, str] = field(default_factory=dict)
    rules: Rules = field(default_factory=Rules)

    @classmethod
    def from_paths(
        cls, paths: Iterable[Path | str], rules: Rules | None = None
    ) -> Self:
        """Raises SimulatorError naming the file that cannot be read."""
        files: dict[str, str] = {}
        for path in map(Path, paths):
            try:
                files[path.name] = path.read_text(encoding="ascii")
            except (OSError, UnicodeDecodeError) as error:
                reason = getattr(error, "strerror", None) or "not plain ASCII"
                raise SimulatorError(f"compensation file {path}: {reason}") from error
        return cls(files, rules or Rules())

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Self:
        return cls(dict(content["files"]), Rules(**content["rules"]))

    def as_json(self) -> dict[str, Any]:
        return {"files": dict(self.files), "rules": asdict(self.rules)}

    def correct(self, machine: MachineFile) -> Correction | None:
        """Correction by the controller; None without files.

        Raises SimulatorError naming the file, and the row where it has one.
        """
        if not self.files:
            return None
        if self.rules.backlash_reading not in BACKLASH_READINGS:
            known = ", ".join(BACKLASH_READINGS)
            raise SimulatorError(f"backlash_reading: expected one of {known}")
        form = _find_form(self.files)
        if form in _OF_THE_VOLUME:
            if len(self.files) > 1:
                raise SimulatorError("tables of the whole volume are one file here")
            ((name, text),) = self.files.items()
            read = _OF_THE_VOLUME[form]
            right: Correction = read(name, text, machine, self.rules)
        else:
            right = _read_tables(form, self.files, machine, self.rules)
        return ReversedCorrection(right) if self.rules.reversed_sign else right


def _read_tables(
    form: str, files: Mapping[str, str], machine: MachineFile, rules: Rules
) -> Correction:
    is_chain, read_chain = _KINEMATICS.get(form, (None, None))
    chains = {name: text for name, text in files.items() if is_chain and is_chain(text)}
    tables = {name: text for name, text in files.items() if name not in chains}
    added = TableCorrection(tuple(_read_terms(form, tables, machine, rules)))
    if not chains or read_chain is None:
        return added
    if len(chains) > 1:
        raise SimulatorError(f"one file sets the kinematics, not {', '.join(chains)}")
    ((name, text),) = chains.items()
    return ChainedCorrection(read_chain(name, text, machine), added)


def _find_form(files: Mapping[str, str]) -> str:
    forms = {name: _detect_form(name, text) for name, text in files.items()}
    if len(set(forms.values())) > 1:
        said = ", ".join(f"{name} is of {form}" for name, form in forms.items())
        raise SimulatorError(f"one controller takes one form: {said}")
    return next(iter(forms.values()))


def _detect_form(name: str, text: str) -> str:
    for form, sign in _SIGNS.items():
        if sign.search(text):
            return form
    raise SimulatorError(
        f"{name} has the form of no simulated controller: LinuxCNC, SINUMERIK, "
        "Heidenhain (.com with its .cma), Fanuc, ISG_CSV, Etalon Exchange or plain "
        "CSV and JSON"
    )


def _read_terms(
    form: str, files: Mapping[str, str], machine: MachineFile, rules: Rules
) -> Iterator[Term]:
    if form == "heidenhain":
        yield from read_heidenhain(files, machine, rules)
    elif form == "fanuc":
        yield from read_fanuc(files, machine)
    elif form == "siemens":
        for name, text in files.items():
            yield from read_siemens(name, text, machine, rules)
    else:
        for name, text in files.items():
            yield from read_linuxcnc(name, text, machine)
