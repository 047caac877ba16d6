"""Machines with rotary axes, measured on the fly along planned lines and arcs."""

from __future__ import annotations

from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

from estimating import estimate, judge_map
from following import compare_tables, list_blocks
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.estimation.live.live import LiveEstimator
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import (
    RecursiveEstimator,
    compute_information,
)
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.planning.lines.default_path import default_path
from truepath_simulators.motion.program import Program

pytestmark = pytest.mark.timeout(300)
NOISE = NoiseModel((1.0, 1.1), (0.3, 0.2, 0.2), 0.9, 2e-4)


def measured(name, seed, stands_on="base", lines=None, share=0.4):
    content = load_small(name, share)
    content["tracker"]["stands_on"] = stands_on
    machine = machine_from_json(content)
    path = default_path(machine, 6000.0, lines=lines, seed=seed)
    program = Program(path.position, path.feed_mm_min / 60, path.dwell_s, path.target)
    run, made = record_run(content, program, seed)
    return SimpleNamespace(run=run, truth=made.truth, seen=align(run))


def judge_first(result, truth):
    """Hold the map of the first target against the truth."""
    return judge_map(result, partial(truth.deviation_mm, target="T1"), "T1")


@cache
def from_base(name, share=0.4):
    found = measured(name, 3, share=share)
    found.result = estimate(found.seen, keep_fit=True)
    return found


@pytest.mark.parametrize(
    "name", ["head-table", pytest.param("trunnion", marks=pytest.mark.long)]
)
def test_a_planned_path_recovers_all_tables_within_their_uncertainties(
    name, deviations
):
    result, truth = from_base(name).result, from_base(name).truth
    names = {e.name for e in result.model.effects}
    assert set(truth.locations()) | set(truth.error_motions()) <= names
    assert result.observability.rank == result.observability.parameters
    assert not result.observability.unobservable
    left = judge_first(result, truth)
    assert left.share < 0.03
    assert left.inside > 0.85
    assert (np.abs(deviations(result, truth)) < 2.0).mean() > 0.87


@pytest.mark.parametrize(
    ("name", "share"),
    [("head-table", 0.4), pytest.param("trunnion", 1.0, marks=pytest.mark.long)],
)
def test_residuals_on_arcs_are_no_more_than_those_of_straight_lines(name, share):
    found = from_base(name, share)
    residuals = found.result.runs[0].residuals
    cells = found.result.fit.runs[0].observations
    line = cells.at.line
    assert residuals.rms_mm < 1.2 * residuals.floor_mm
    turning = np.array([_turns(found.run, p.row) for p in found.seen.passes])
    # Targets on the table move on arcs alone: only the others can be compared.
    on_tool = np.array([_is_on_tool(found.run, p.row) for p in found.seen.passes])
    bent = (line >= 0) & (on_tool & turning)[line]
    straight = (line >= 0) & (on_tool & ~turning)[line]
    assert min(bent.sum(), straight.sum()) > 300
    across = np.square(residuals.across_mm * np.sqrt(cells.count))
    assert across[bent].mean() < 1.3 * across[straight].mean()


def _turns(run, row):
    return bool(np.diff(run.commanded.position[row - 1 : row + 1], axis=0)[0][3:].any())


def _is_on_tool(run, row):
    return run.machine.target(run.commanded.target[row]).on == "tool"


@pytest.mark.long
def test_a_tracker_on_the_table_sees_turns_of_both_sides():
    found = measured("head-table", 4, "workpiece")
    assert set(found.run.commanded.target) == {"T1", "T2", "T3"}
    left = judge_first(estimate(found.seen), found.truth)
    assert left.share < 0.03
    assert left.inside > 0.85


def test_arcs_and_stops_added_one_by_one_are_the_batch(rng):
    seen = from_base("head-table").seen
    model, _ = build_identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=5)
    about = linearise(seen, model, seen.pose, NOISE)
    sums = RecursiveEstimator.start(about)
    cuts = np.sort(rng.choice(np.arange(1, len(seen)), 40, replace=False))
    for part in np.split(np.arange(len(seen)), cuts):
        sums = sums.add(seen.select(part))
    expected = compute_information(seen, about)
    found = sums.information()
    scale = 1.0 / np.sqrt(np.diag(expected.matrix))
    off = (found.matrix - expected.matrix) * scale[:, None] * scale
    assert np.abs(off).max() < 1e-9
    pull = (found.vector - expected.vector) * scale
    assert np.abs(pull).max() < 1e-9 * np.sqrt(expected.square)
    assert found.square == pytest.approx(expected.square, rel=1e-9)


@pytest.mark.long
def test_the_live_tables_tighten_and_end_as_those_of_the_batch():
    run, batch = from_base("trunnion").run, from_base("trunnion").result
    live, early = LiveEstimator(run.machine, run.commanded), None
    blocks = list_blocks(run, 500)
    for number, block in enumerate(blocks):
        if live.take(block) and early is None and number > len(blocks) // 3:
            early = live.estimate()  # no target on the table has been seen yet
    live.finish()
    last = live.estimate()
    assert early.volumetric_sigma_mm > 10 * last.volumetric_sigma_mm
    off = compare_tables(last, batch)
    assert np.abs(off).max() < 2.0
    assert np.sqrt(np.mean(off**2)) < 0.5
