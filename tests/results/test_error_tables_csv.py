"""`error_tables.csv`: a value a row, its unit beside it."""

import csv
import io

import numpy as np
import pytest

from truepath.files.earlier.verdict import Reason, Verdict
from truepath.results.error_table_files import error_tables_csv


@pytest.fixture
def rows(found):
    return list(
        csv.DictReader(io.StringIO(error_tables_csv(found.tables, found.verdict)))
    )


def test_each_value_stands_with_its_uncertainty_and_unit(found, rows):
    for table in found.tables.tables:
        mine = [r for r in rows if r["error"] == table.symbol]
        assert {r["unit"] for r in mine} == {table.unit}
        for column, numbers in (
            ("position_mm", table.position_mm),
            ("value", table.value),
            ("uncertainty", table.uncertainty),
        ):
            read = np.array([float(r[column]) for r in mine])
            assert read == pytest.approx(numbers, abs=1e-4)


def test_a_squareness_belongs_to_no_position(rows):
    squares = [r for r in rows if r["error"] in ("C0Y", "B0Z", "A0Z")]
    assert len(squares) == 3
    assert {(r["position_mm"], r["unit"]) for r in squares} == {("", "urad")}


def test_nothing_is_said_of_what_is_not_known(found, rows):
    assert {r["error"] for r in rows}.isdisjoint({"EAZ", "EBZ", "ECZ"})
    assert len(rows) == sum(len(t.value) for t in found.tables.tables) + 3


def test_no_zero_carries_a_minus_sign(found):
    assert "-0.00000" not in error_tables_csv(found.tables, found.verdict)


def test_every_row_says_whether_the_result_may_be_used(found, rows):
    assert {r["verdict"] for r in rows} == {"usable"}
    spoilt = Verdict((Reason("fit-beyond-noise", "not-usable", {}),))
    text = error_tables_csv(found.tables, spoilt)
    read = list(csv.DictReader(io.StringIO(text)))
    assert {r["verdict"] for r in read} == {"not-usable"}
    assert len(read) == len(rows)
