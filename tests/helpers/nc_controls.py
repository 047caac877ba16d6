"""Controls that run NC programs as their manuals say; nothing of the planner is used.

Each drives what a program says from where the axes stand, halts where it halts, and
keeps what it was told: messages, modes at the end.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np

from truepath_simulators.motion.program import Arc, Program

COLUMNS = "XYZABC"
FANUC_GROUPS = {
    "unit": ("20", "21"),
    "path": ("61", "64"),
    "plane": ("17", "18", "19"),
    "motion": ("0", "1", "2", "3"),
}
PLANES = {"17": "XY", "18": "ZX", "19": "YZ"}


class Alarm(Exception):
    """The control stops and shows an alarm."""


@dataclass
class Move:
    """One motion; halted : the operator was asked after it, with these words."""

    end: dict
    feed: float
    dwell_s: float = 0.0
    arc: tuple | None = None  # plane, centre, turn in rad
    halted: str = ""
    stops: bool = True


@dataclass
class Control:
    """Axes, modes and what was driven; positions are those of the machine."""

    place: dict = field(default_factory=lambda: {"X": 1.0, "Y": 2.0, "Z": -3.0})
    moves: list = field(default_factory=list)
    feed: float = 0.0
    said: str = ""
    first_words: str = ""
    ended: bool = False

    def drive(self, ends, *, stops=True, arc=None):
        """Take the axes to machine positions, by an arc about a centre if given."""
        if not self.feed > 0:
            raise Alarm("no feed")
        begin = dict(self.place)
        self.place |= ends
        turned = None
        if arc:
            plane, centre, positive, turns = arc
            zero = dict(zip(plane, centre, strict=True))
            ends = begin, self.place
            away = [complex(*(at[n] - zero[n] for n in plane)) for at in ends]
            if abs(abs(away[0]) - abs(away[1])) > 0.005:
                raise Alarm("the end is not on the circle")
            turn = math.atan2((away[1] / away[0]).imag, (away[1] / away[0]).real)
            turn = (turn if positive else -turn) % math.tau
            if all(begin[name] == self.place[name] for name in plane):
                turn = math.tau
            turned = plane, centre, (1 if positive else -1) * (turn + math.tau * turns)
        self.moves.append(Move(dict(self.place), self.feed, 0.0, turned, "", stops))

    def wait(self, seconds):
        if self.moves:
            self.moves[-1].dwell_s += seconds

    def halt(self):
        if self.moves:
            self.moves[-1].halted = self.said
        else:
            self.first_words = self.said

    def approach(self):
        return self.moves[: self._recorded()]

    def recorded(self, axes="XYZ"):
        """What moves while the tracker records, as the simulated machine drives it.

        Blocks of one arc that the axes do not stop between are one motion.
        """
        first = self._recorded() - 1
        rows = []
        for move in self.moves[first:]:
            last = rows[-1] if rows else None
            if last and not last.stops and not last.dwell_s and last.arc and move.arc:
                plane, centre, turn = last.arc
                assert np.allclose(centre, move.arc[1], atol=0.002)
                move.arc = plane, centre, turn + move.arc[2]
                rows.pop()
            rows.append(move)
        rows[0].arc = None
        arcs = [
            m.arc and Arc(tuple(map(COLUMNS.index, m.arc[0])), *m.arc[1:]) for m in rows
        ]
        position = np.array([[move.end[name] for name in axes] for move in rows])
        feed = np.array([move.feed / 60.0 for move in rows])
        dwell_s = np.array([move.dwell_s for move in rows])
        return Program(position, feed, dwell_s, (), tuple(arcs) if any(arcs) else ())

    def _recorded(self):
        asked = [n for n, m in enumerate(self.moves) if "START THE REC" in m.halted]
        assert len(asked) == 1, self.moves
        assert "STOP THE RECORDING" in self.moves[-1].halted
        return asked[0] + 1


def run_heidenhain(text, datum=(0.0, 0.0, 0.0)):
    """Klartext; datum : where the workpiece's zero is in the machine."""
    control = Control()
    shift = dict(zip("XYZ", datum, strict=True))
    tolerance, pole = None, None
    for number, line in enumerate(text.splitlines()):
        own, _, block = line.partition(" ")
        assert int(own) == number, line
        block, _, comment = (part.strip() for part in block.partition(";"))
        if comment and not block:
            control.said = comment
        if re.match(r"(BEGIN|END) PGM \w+ MM$|$", block):
            continue
        words = re.findall(r"(I?[XYZABC])([-+]\d+\.\d*)", block)
        feed = re.search(r" F(\d+\.?\d*)", block)
        control.feed = float(feed.group(1)) if feed else control.feed
        if block.startswith("L "):
            of_machine = dict.fromkeys(COLUMNS, 0.0)
            zero = of_machine if block.endswith("M91") else of_machine | shift
            control.drive({n: zero[n] + float(v) for n, v in words}, stops=False)
        elif block.startswith("CC "):
            pole = {n[-1]: control.place[n[-1]] + float(v) for n, v in words}
            assert all(n.startswith("I") for n, _ in words), line
        elif block.startswith("C "):
            ends = {n[-1]: round(control.place[n[-1]] + float(v), 6) for n, v in words}
            assert all(n.startswith("I") for n, _ in words), line
            plane = next(p for p in PLANES.values() if {*p} == {*pole} == {*ends})
            arc = plane, tuple(pole[n] for n in plane), "DR+" in block, 0
            control.drive(ends, stops=False, arc=arc)
        elif block.startswith("CYCL DEF 9.1 DWELL "):
            control.wait(float(block.split()[-1]))
        elif block.startswith("CYCL DEF 32.1"):
            tolerance = block[13:].strip()
        elif block == "STOP":
            control.halt()
        elif block == "M30":
            control.ended = True
        else:
            assert re.fullmatch(r"CYCL DEF (9|32)\.0 [A-Z ]+", block), line
        if block.startswith(("L ", "C ")):
            assert tolerance == "T0.002", "smoothing is not bounded"
    assert tolerance == "", "the machine's own tolerance is not put back"
    return control


def run_siemens(text, frame=(0.0, 0.0, 0.0)):
    """SINUMERIK; frame : of the work offset that was set before."""
    control, modes = Control(), {}
    shift = dict(zip("XYZ", frame, strict=True))
    for line in text.splitlines():
        block = re.sub(r"^N\d+ ", "", line)
        if message := re.match(r'MSG\("([^"]*)"\)', block):
            control.said = message.group(1)
            continue
        block = block.partition(";")[0].strip()
        turn = re.search(r"TURN=(\d+)", block)
        plain = re.sub(r"TURN=\d+|FGROUP\([^)]*\)", "", block)
        codes = re.findall(r"\b([GMD]\d+|SUPA|TRAFOOF|TRANS|COMPOF)\b", plain)
        words = dict(re.findall(r"\b([XYZABCIJKF])(-?\d+\.?\d*)", plain))
        for code in codes:
            for group in ("G60 G64", "G17 G18 G19", "G70 G71 G700 G710", "G90 G91"):
                if code in group.split():
                    modes[group] = code
        if "G4" in codes:
            control.wait(float(words["F"]))
            continue
        if "M0" in codes:
            control.halt()
        control.ended |= "M30" in codes
        control.feed = float(words.get("F", control.feed))
        axes = {n: float(v) for n, v in words.items() if n in COLUMNS}
        if not axes:
            continue
        assert modes["G70 G71 G700 G710"] == "G710"
        assert modes["G90 G91"] == "G90"
        kind = next(code for code in codes if code in ("G0", "G1", "G2", "G3"))
        zero = {} if "SUPA" in codes else shift
        ends = {n: v + zero.get(n, 0.0) for n, v in axes.items()}
        arc = None
        if kind in ("G2", "G3"):
            plane = PLANES[modes["G17 G18 G19"][1:]]
            to = [float(words["IJK"["XYZ".index(n)]]) for n in plane]
            centre = [control.place[n] + d for n, d in zip(plane, to, strict=True)]
            arc = plane, tuple(centre), kind == "G3", int(turn.group(1)) if turn else 0
        control.drive(ends, stops=modes["G60 G64"] == "G60", arc=arc)
    assert modes["G60 G64"] == "G64"
    return control


def run_fanuc(text, unit="21", offset=(0.0, 0.0, 0.0)):
    """Fanuc with custom macro B; unit : 20 or 21, as it was left; offset : of G54."""
    control, modes, variables = Control(), {"unit": unit, "path": "64"}, {}
    shift = dict(zip("XYZ", offset, strict=True))
    lines = text.splitlines()
    assert lines[0] == lines[-1] == "%"
    for line in lines[2:-1]:
        if control.ended:
            raise Alarm("a block after M30")
        block = re.sub(r"^/?(N\d+ )?/?", "", line)
        if comment := re.fullmatch(r"\((.*)\)", block):
            control.said = comment.group(1)
            continue
        block = re.sub(r"\([^)]*\)", "", block).strip()
        if macro := re.fullmatch(r"#(\d+)=#4006", block):
            variables[macro.group(1)] = modes["unit"]
            continue
        guard = r"IF \[ABS\[#(502\d)-#(504\d)\] GT 0\.001\] THEN #3000=\d+"
        if guarded := re.fullmatch(guard, block):
            machine, work = (int(number) for number in guarded.groups())
            assert machine - 5021 == work - 5041
            if abs(shift[COLUMNS[machine - 5021]]) > 0.001:
                raise Alarm("an axis has an offset")
            continue
        # A variable without a value takes its letter along.
        block = re.sub(r"G#(\d+)", lambda m: f"G{variables.get(m[1], '')}", block)
        codes = re.findall(r"([GM])(\d+(?:\.\d)?)", block)
        for group, known in FANUC_GROUPS.items():
            for letter, number in codes:
                if letter == "G" and number in known:
                    modes[group] = number
        size = 1.0 if modes["unit"] == "21" else 25.4
        words = dict(re.findall(r"([XYZABCIJKF])(-?\d*\.?\d*)", block))
        counts = {n: 1.0 if "." in v else 0.001 for n, v in words.items()}
        if ("G", "4") in codes:
            control.wait(float(words["X"]) * counts["X"])
            continue
        if ("M", "0") in codes:
            control.halt()
        control.ended = ("M", "30") in codes
        if "F" in words:
            control.feed = float(words["F"]) * size
        sizes = {n: float(v) * counts[n] * size for n, v in words.items() if n != "F"}
        ends = {n: v + shift.get(n, 0.0) for n, v in sizes.items() if n in COLUMNS}
        arc = None
        if ends and modes["motion"] in ("2", "3"):
            plane = PLANES[modes["plane"]]
            to = [sizes["IJK"["XYZ".index(n)]] for n in plane]
            centre = [control.place[n] + d for n, d in zip(plane, to, strict=True)]
            arc = plane, tuple(centre), modes["motion"] == "3", 0
        if ends:
            control.drive(ends, stops=modes["path"] == "61", arc=arc)
    assert control.ended
    control.unit = modes["unit"]
    return control


RUN = {"heidenhain": run_heidenhain, "siemens-840d": run_siemens, "fanuc": run_fanuc}
