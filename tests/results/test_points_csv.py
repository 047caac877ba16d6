"""Points in, predictions out."""

import csv
import io

import numpy as np
import pytest

from truepath.answers.calibration.points_csv import encode_predictions, read_points
from truepath.errors import BundleError
from truepath.results.prediction import Prediction, predict

HEADER = "x_mm,y_mm,z_mm"


@pytest.fixture
def machine(loaded):
    return loaded.machine


def test_the_answer_holds_the_question_and_six_numbers_more(loaded, machine):
    asked = f'{HEADER},label\n10.50,20,30,first\n-1e2,4e+01,0.5,"a, b"\n'
    points = read_points(asked.encode(), machine)
    predicted = predict(loaded, points.position)
    rows = list(csv.reader(io.StringIO(encode_predictions(points, predicted))))
    assert rows[0] == [
        *("x_mm", "y_mm", "z_mm", "label"),
        *("dx_um", "dy_um", "dz_um", "ux_um", "uy_um", "uz_um"),
    ]
    assert rows[1][:4] == ["10.50", "20", "30", "first"]
    assert rows[2][:4] == ["-1e2", "4e+01", "0.5", "a, b"]
    numbers = np.array([row[4:] for row in rows[1:]], float)
    expected = np.hstack([predicted.error_um, predicted.uncertainty_um])
    assert numbers == pytest.approx(expected, abs=1e-5)


def test_the_order_of_the_columns_does_not_matter(machine):
    points = read_points(b"z_mm,note,x_mm,y_mm\n3,n,1,20\n", machine)
    assert points.position.tolist() == [[1.0, 20.0, 3.0]]


def test_an_answer_can_be_asked_again(loaded, machine):
    points = read_points(f"{HEADER}\n1,20,3\n".encode(), machine)
    once = encode_predictions(points, predict(loaded, points.position))
    again = read_points(once.encode(), machine)
    assert encode_predictions(again, predict(loaded, again.position)) == once


def test_no_zero_carries_a_minus_sign(machine):
    points = read_points(f"{HEADER}\n1,20,3\n".encode(), machine)
    nothing = Prediction(np.full((1, 3), -1e-9), np.zeros((1, 3)), ())
    assert "-0.00000" not in encode_predictions(points, nothing)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "p.csv, row 1: has no header"),
        ("x_mm,y_mm\n1,2\n", "p.csv, column z_mm: is missing"),
        (f"{HEADER}\n", "p.csv: has no rows"),
        (f"{HEADER}\n1,20,3\n1,nan,3\n", "p.csv, row 3, column y_mm: is empty or NaN"),
        (f"{HEADER}\n1,20,\n", "p.csv, row 2, column z_mm: is empty or NaN"),
        (f"{HEADER}\n1,20,inf\n", "p.csv, row 2, column z_mm: is infinite"),
        (f"{HEADER}\n1,left,3\n", "p.csv, row 2, column y_mm: is 'left', not a number"),
        (f"{HEADER}\n1,20\n", "p.csv, row 2: has 2 cells, the header 3"),
        (f"{HEADER}\n1e9,20,3\n", "p.csv, row 2, column x_mm: is 1e+09, no position"),
        (f"{HEADER},x_mm\n1,20,3,4\n", "column x_mm: appears more than once"),
    ],
)
def test_bad_points_are_one_clear_error(machine, text, said):
    with pytest.raises(BundleError) as caught:
        read_points(text.encode(), machine, file="p.csv")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_point_may_name_its_target(construct, three_targets):
    machine = construct(three_targets).model.machine
    points = read_points(f"{HEADER},target\n1,20,3,long\n".encode(), machine)
    assert points.target == ("long",)
    with pytest.raises(BundleError, match=r"row 2, column target: is 'T9', unknown"):
        read_points(f"{HEADER},target\n1,20,3,T9\n".encode(), machine)


def test_a_machine_without_named_targets_passes_the_column_on(machine):
    points = read_points(f"{HEADER},target\n1,20,3,T9\n".encode(), machine)
    assert points.target == ()
    assert "target" in points.table.names
