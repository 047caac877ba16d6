"""The check of formats lets ours pass, and names what is wrong with another."""

import numpy as np
import pytest

from plugin_site import install
from truepath.compensation import conformance, format_registry
from truepath.compensation.conformance import what_is_read_back_is_minus_the_error
from truepath.compensation.format import InterpolatedTable, TableFormat
from truepath.compensation.format_registry import list_formats, load_format
from truepath.kinematics.effects.conformance import NotConforming
from truepath.operation import plugin_list


class Rows(TableFormat):
    """A line has axis, position, and what is added to X, Y, Z each way."""

    control, suffix, most_points = "Rows", ".lst", 200
    carries = not_carried = sign = note = "see above"
    sign_is_verified = False
    directions = "each by itself"

    def write(self, content):
        lines = []
        for table in content.tables:
            rows = self.spoil(-np.hstack([table.forward_mm, table.backward_mm]))
            for at, row in zip(table.position_mm, rows, strict=True):
                cells = " ".join(f"{value:.6f}" for value in row)
                lines.append(f"{table.axis.name} {at:.4f} {cells}")
        return {content.stem + self.suffix: "\n".join(self.choose(lines))}

    def read_tables(self, files, machine):
        ((_, text),) = files.items()
        rows = [line.split() for line in text.splitlines()]
        for axis in sorted({row[0] for row in rows}):
            at, *added = np.array([r[1:] for r in rows if r[0] == axis], float).T
            for out in range(3):
                yield InterpolatedTable(axis, out, at, added[out], added[3 + out])

    def spoil(self, rows):
        return rows

    def choose(self, lines):
        return lines


def spoils(change):
    return {"spoil": lambda self, rows: change(rows)}


def chooses(change):
    return {"choose": lambda self, lines: change(lines)}


def average(rows):
    return np.tile(0.5 * (rows[:, :3] + rows[:, 3:]), 2)


def shape_wrongly(self, files, machine):
    return lambda position, direction: np.zeros(len(position))


BOTH = r"expected -?[0-9.]+ µm, read -?[0-9.]+(e[+]\d+)? µm: "
WRONG = {
    "sign": (spoils(np.negative), BOTH + "the sign is reversed"),
    "directions": (
        spoils(lambda rows: np.roll(rows, 3, axis=1)),
        BOTH + "the two directions are swapped",
    ),
    "micrometres": (spoils(lambda rows: 1e3 * rows), "1000 times the value, as in µm"),
    "metres": (spoils(lambda rows: 1e-3 * rows), "0.001 times the value"),
    "sign and unit": (spoils(lambda r: -1e3 * r), "for mm, and the sign is reversed"),
    "ten times": (spoils(lambda rows: 10.0 * rows), BOTH + "it is 10 times the value$"),
    "inches": (spoils(lambda r: r / 25.4 * -4.0), "it is -0.157 times the value$"),
    "order": (spoils(lambda rows: rows[::-1]), "the rows are in reverse order"),
    "columns": (
        spoils(lambda rows: rows[:, [0, 2, 1, 3, 5, 4]]),
        "added to Y.*that is added to Z as X moves",
    ),
    "one row": (
        chooses(lambda lines: [*lines[:30], *lines[31:]]),
        "^Y at .*1 of 21 rows are missing, moved or wrong",
    ),
    "last rows": (chooses(lambda lines: lines[:-2]), "^Z at .*2 of 21 rows"),
    "an axis": (chooses(lambda lines: lines[:42]), "X, Y is read back, Z not"),
    "mean": (spoils(average), "'each by itself', but read is the mean of both"),
    "each": ({"directions": "mean of both"}, "but read is each direction by itself"),
    "nothing": (spoils(lambda rows: 0.0 * rows), "add nothing anywhere"),
    "shape": ({"read": shape_wrongly}, r"has the shape \(21,\), expected \(21, 3\)"),
}


@pytest.mark.parametrize("name", list_formats())
def test_an_installed_format_conforms(name):
    what_is_read_back_is_minus_the_error(load_format(name))


@pytest.mark.parametrize("resolution_um", [1e-3, 1.0, 10.0])
def test_rounding_within_the_resolution_conforms(resolution_um):
    step_mm = 1e-3 * resolution_um
    change = spoils(lambda rows: step_mm * np.rint(rows / step_mm))
    kind = type("Round", (Rows,), {"resolution_um": resolution_um, **change})
    what_is_read_back_is_minus_the_error(kind())
    finer = type("Finer", (kind,), {"resolution_um": 0.1 * resolution_um})
    with pytest.raises(NotConforming, match="rows are"):
        what_is_read_back_is_minus_the_error(finer())


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_with_a_format_is_named_with_both_values(wrong):
    changes, said = WRONG[wrong]
    with pytest.raises(NotConforming, match=said):
        what_is_read_back_is_minus_the_error(type("Wrong", (Rows,), changes)())


TURNED = """
    from truepath.compensation.formats.generic import GenericCsv

    class Turned(GenericCsv):
        def read(self, files, machine):
            correct = super().read(files, machine)
            return lambda at, side: -correct(at, side)
"""


def test_the_check_of_plug_ins_names_it_and_what_stays_unproved(tmp_path, monkeypatch):
    points = {"compensation_formats": {"turned": "turned:Turned"}}
    monkeypatch.syspath_prepend(install(tmp_path, points, turned=TURNED))
    monkeypatch.setattr(plugin_list, "INTERFACE_VERSIONS", {format_registry.GROUP: 1})
    found = {one.name: one for one in plugin_list.list_plugins(checks=True)}
    (told,) = found["turned"].failures
    assert told.startswith("what_is_read_back_is_minus_the_error: X at ")
    assert told.endswith("the sign is reversed")
    assert found["turned"].unproved == conformance.UNPROVED
    assert found["csv"].was_checked
    assert found["csv"].is_well
    assert not found["csv"].unproved
