"""Monte Carlo as a science job does it: a real lane, its workers, its files."""

from __future__ import annotations

import json
import threading

import psutil
import pytest
from scripted_cell import wait_until

from truepath.catalogue.errors import Aborted, TaskFailed
from truepath.jobs.workers.executor import ProcessExecutor
from truepath.jobs.workers.science import analyse_recorded
from truepath.jobs.workers.workers import Workers
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.progress import ignore_progress

TWO_BLOCKS = TrialPlan(seed=5, most_blocks=2)


@pytest.fixture
def run_files(small_run):
    return [str(small_run)]


@pytest.fixture
def lane():
    lanes = ProcessExecutor(1)
    yield lanes
    lanes.close()


def submit(lane, *arguments, on_progress=ignore_progress):
    return lane.submit(
        analyse_recorded, *arguments, on_progress=on_progress, started=lambda: None
    )


def trials_in(folder):
    return json.loads((folder / "result.json").read_text())["monte_carlo"]


def test_a_job_brings_the_same_trials_from_any_workers(lane, run_files, tmp_path):
    told: list[tuple[float, str]] = []
    for count in (1, 2):
        submit(
            lane,
            run_files,
            str(tmp_path / str(count)),
            False,
            TWO_BLOCKS,
            Workers(count=count),
            on_progress=lambda *stage: told.append(stage),
        ).result()
    one, other = (trials_in(tmp_path / str(count)) for count in (1, 2))
    assert one == other
    assert (one["seed"], one["trials"]) == (5, 20_000)
    assert "held against trials" in (tmp_path / "1" / "report.html").read_text()
    stages = list(dict.fromkeys(stage for _, stage in told))
    assert stages == ["aligning", "estimating", "validating", "reporting"]


def test_a_job_brings_the_same_trials_from_a_cluster(
    lane, run_files, tmp_path, scheduler
):
    places = (Workers(count=2), Workers("dask", scheduler=scheduler))
    for workers in places:
        folder = str(tmp_path / workers.kind)
        submit(lane, run_files, folder, False, TWO_BLOCKS, workers).result()
    here, there = (trials_in(tmp_path / workers.kind) for workers in places)
    assert here == there


def test_an_aborted_job_ends_its_workers_and_leaves_no_result(
    lane, run_files, tmp_path
):
    trying = threading.Event()

    def on_progress(_, stage):
        if stage == "validating":
            trying.set()

    before = set(psutil.Process().children(recursive=True))
    endless = TrialPlan(digits=2, most_blocks=10_000)
    job = submit(
        lane,
        run_files,
        str(tmp_path / "result"),
        False,
        endless,
        Workers(count=2),
        on_progress=on_progress,
    )
    outcome: list[object] = []
    waiting = threading.Thread(target=lambda: outcome.append(_error_of(job)))
    waiting.start()
    assert trying.wait(30.0)
    job.cancel()
    waiting.join(10.0)
    assert isinstance(outcome[0], Aborted)
    assert not (tmp_path / "result").exists()
    wait_until(
        lambda: (
            not [
                p for p in psutil.Process().children(recursive=True) if p not in before
            ]
        ),
        "the end of the workers",
    )


def test_a_cluster_that_is_away_fails_the_job_by_name(
    lane, run_files, tmp_path, free_tcp_port
):
    away = Workers("dask", scheduler=f"tcp://127.0.0.1:{free_tcp_port}", patience_s=0.5)
    job = submit(lane, run_files, str(tmp_path / "result"), False, TWO_BLOCKS, away)
    with pytest.raises(TaskFailed, match="no Dask scheduler answers") as raised:
        job.result()
    assert raised.value.family == "WorkersAway"


def _error_of(job):
    try:
        return job.result()
    except Aborted as error:
        return error
