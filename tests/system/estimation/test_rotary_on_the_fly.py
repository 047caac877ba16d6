"""Machines with rotary axes, measured on the fly along planned lines and arcs."""

from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.estimation.test_recursive import about_of, added_in_parts, assert_same

from estimating import estimate, judge_map
from following import compare_tables, list_blocks
from recorded import load_small, record_path
from truepath.alignment.align import align
from truepath.estimation.live.live import LiveEstimator
from truepath.estimation.problem.normal_equations import compute_information
from truepath.files.bundle.machine_file import machine_from_json
from truepath.planning.default_path import default_path

pytestmark = pytest.mark.timeout(300)


def measured(name, seed, stands_on="base", share=0.4):
    content = load_small(name, share)
    content["tracker"]["stands_on"] = stands_on
    path = default_path(machine_from_json(content), 6000.0, seed=seed)
    run, made = record_path(content, path, seed)
    return SimpleNamespace(run=run, truth=made.truth, seen=align(run))


def assert_map_is_found(result, truth):
    left = judge_map(result, partial(truth.deviation_mm, target="T1"), "T1")
    assert left.share < 0.03
    assert left.inside > 0.85


@cache
def from_base(name, share=0.4):
    found = measured(name, 3, share=share)
    found.result = estimate(found.seen)
    return found


@pytest.mark.parametrize(
    "name", ["head-table", pytest.param("trunnion", marks=pytest.mark.long)]
)
def test_a_planned_path_recovers_all_tables_within_their_uncertainty(name, deviations):
    result, truth = from_base(name).result, from_base(name).truth
    names = {e.name for e in result.model.effects}
    assert set(truth.locations()) | set(truth.error_motions()) <= names
    assert result.observability.rank == result.observability.parameters
    assert not result.observability.unobservable
    assert_map_is_found(result, truth)
    assert (np.abs(deviations(result, truth)) < 2.0).mean() > 0.87


@pytest.mark.parametrize(
    ("name", "share"),
    [("head-table", 0.4), pytest.param("trunnion", 1.0, marks=pytest.mark.long)],
)
def test_residuals_on_arcs_are_no_more_than_those_of_straight_lines(name, share):
    found = from_base(name, share)
    residuals = found.result.runs[0].residuals
    cells, path = found.result.fit.runs[0].observations, found.run.commanded
    line = cells.at.line
    assert residuals.rms_mm < 1.2 * residuals.floor_mm
    rows = [each.row for each in found.seen.passes]
    turning = np.diff(path.position, axis=0)[np.array(rows) - 1, 3:].any(axis=1)
    # Targets on the table move on arcs alone: only the others can be compared.
    on_tool = np.array([path.target[row].startswith("T") for row in rows])
    bent = (line >= 0) & (on_tool & turning)[line]
    straight = (line >= 0) & (on_tool & ~turning)[line]
    assert min(bent.sum(), straight.sum()) > 300
    across = np.square(residuals.across_mm * np.sqrt(cells.count))
    assert across[bent].mean() < 1.3 * across[straight].mean()


@pytest.mark.long
def test_a_tracker_on_the_table_sees_turns_of_both_sides():
    found = measured("head-table", 4, "workpiece")
    assert set(found.run.commanded.target) == {"T1", "T2", "T3"}
    assert_map_is_found(estimate(found.seen), found.truth)


def test_arcs_and_stops_added_one_by_one_are_the_batch(rng):
    seen = from_base("head-table").seen
    about = about_of(seen)
    cuts = rng.choice(np.arange(1, len(seen)), 40, replace=False)
    sums = added_in_parts(about, seen, cuts)
    assert_same(sums.information(), compute_information(seen, about))


@pytest.mark.long
def test_the_live_tables_tighten_and_end_as_those_of_the_batch():
    run, batch = from_base("trunnion").run, from_base("trunnion").result
    live, early = LiveEstimator(run.machine, run.commanded), None
    blocks = list_blocks(run, 500)
    for number, block in enumerate(blocks):
        if live.add_block(block) and early is None and number > len(blocks) // 3:
            early = live.estimate()  # no target on the table has been seen yet
    live.finish()
    last = live.estimate()
    assert early.volumetric_sigma_mm > 10 * last.volumetric_sigma_mm
    off = compare_tables(last, batch)
    assert np.abs(off).max() < 2.0
    assert np.sqrt(np.mean(off**2)) < 0.5
