"""Adding cells while they come is the same as taking all of them at once."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.alignment.align import align
from truepath.errors import EstimationError
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import Information, OwnParameters
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import (
    RecursiveEstimator,
    compute_information,
)
from truepath.kinematics.identifiable import build_identifiable_model

NOISE = NoiseModel((1.0, 1.1), (0.3, 0.2, 0.2), 0.9, 2e-4)
DIGITS = 1e-9


def about_of(seen, noise=NOISE):
    model, _ = build_identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=5)
    return linearise(seen, model, seen.pose, noise)


def all_at_once(about, seen):
    design = about.build(seen)
    order = np.r_[: design.fixed, design.fixed + 1 : design.rows.shape[2], design.fixed]
    rows = design.rows[:, :, order]
    whitener = design.whiten(about.noise)
    total = np.tensordot(rows, whitener.apply(rows), axes=((0, 1), (0, 1)))
    data = Information.from_total(total, whitener.log_determinant)
    return OwnParameters.of(data, about.size).eliminate()


def added_in_parts(about, seen, cuts):
    sums = RecursiveEstimator.start(about)
    for part in np.split(np.arange(len(seen)), sorted(cuts)):
        sums = sums.add(seen.select(part))
    return sums


def assert_same(found, expected):
    scale = 1.0 / np.sqrt(np.diag(expected.matrix))
    off = (found.matrix - expected.matrix) * scale[:, None] * scale
    assert np.abs(off).max() < DIGITS
    pull = (found.vector - expected.vector) * scale
    assert np.abs(pull).max() < DIGITS * np.sqrt(expected.square)
    assert found.square == pytest.approx(expected.square, rel=DIGITS)
    assert found.log_determinant == pytest.approx(expected.log_determinant, rel=DIGITS)


@pytest.fixture(scope="module")
def moving(record):
    return align(record(3)[0])


@pytest.fixture(scope="module")
def expected(moving):
    return all_at_once(about_of(moving), moving)


@given(share=st.sets(st.floats(0.001, 0.999), max_size=12))
@settings(deadline=None, max_examples=15)
def test_any_split_into_additions_gives_the_batch(moving, expected, share):
    cuts = {1 + int(s * (len(moving) - 1)) for s in share}
    sums = added_in_parts(about_of(moving), moving, cuts)
    assert sums.cells == len(moving)
    assert_same(sums.information(), expected)


def test_a_line_at_a_time_gives_the_batch_and_asking_changes_nothing(moving, expected):
    sums = RecursiveEstimator.start(about_of(moving))
    ends = np.flatnonzero(np.diff(moving.at.line)) + 1
    for part in np.split(np.arange(len(moving)), ends):
        sums = sums.add(moving.select(part))
        sums.information()
    assert_same(sums.information(), expected)


def test_the_sums_do_not_grow_with_the_lines_and_refuse_cells_out_of_order(moving):
    about = about_of(moving)
    first = moving.select(np.flatnonzero(moving.at.line == 0))
    one, every = (RecursiveEstimator.start(about).add(seen) for seen in (first, moving))
    # The timing of a line under way is among them; that of finished ones is not.
    for sums in (one.sums, every.sums):
        assert about.size + 1 <= len(sums.total) <= about.size + 3
    later = moving.select(np.arange(20, 30))
    sums = RecursiveEstimator.start(about_of(moving)).add(later)
    with pytest.raises(EstimationError, match="order of time"):
        sums.add(moving.select(np.arange(10)))


@pytest.mark.parametrize("cells", [1, 60, 10_000])
def test_a_batch_in_parts_is_one_dense_problem(moving, expected, cells, monkeypatch):
    monkeypatch.setattr("truepath.estimation.problem.design_matrix._CELLS", cells)
    about = about_of(moving)
    parts = list(about.split(moving))
    assert sum(len(part.observations) for part in parts) == len(moving)
    assert (len(parts) > 1) == (cells < len(moving))
    assert_same(compute_information(moving, about), expected)


def test_lines_and_standstills_in_one_measurement_add_up_to_the_batch(moving):
    # Every third line is taken for a standstill: what it says does not matter here.
    still = moving.at.line % 3 == 0
    line = np.where(still, -1, moving.at.line)
    velocity_mm_s = moving.at.velocity_mm_s * ~still[:, None]
    at = replace(moving.at, line=line, velocity_mm_s=velocity_mm_s)
    seen = replace(moving, at=at)
    about = about_of(seen)
    sums = RecursiveEstimator.start(about).add(seen)
    assert_same(sums.information(), all_at_once(about, seen))


def test_white_noise_needs_no_tail_and_across_the_travel_timing_is_no_unknown(moving):
    about = about_of(moving, NoiseModel((1.0, 1.0), (0.0, 0.0, 0.0), 1.0, 2e-4))
    sums = added_in_parts(about, moving, [10, 11, 200])
    assert sums.sums.state is None
    assert_same(sums.information(), all_at_once(about, moving))
    about = about_of(moving, replace(NOISE, along_sigma_mm=np.inf))
    parts = (added_in_parts(about, moving, cuts).information() for cuts in ([40], []))
    size = about.machine_model.size
    a, b = (OwnParameters.of(told, size).eliminate() for told in parts)
    assert np.allclose(a.matrix, b.matrix, rtol=1e-7)
    assert np.linalg.eigvalsh(a.matrix).min() > -1e-6 * np.linalg.norm(a.matrix)
