"""The task of a science job: files of Runs in, the files of their result out."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

from app.jobs.runs import open_recorded
from app.jobs.workers import Workers, opened
from app.numerics.adaptive_trials import TrialPlan


def analyse_recorded(
    run_files: Sequence[str],
    folder: str,
    perpendicular_only: bool,
    monte_carlo: TrialPlan | None,
    workers: Workers,
    *,
    progress: Callable[[float, str], None],
) -> None:
    """Analyse Runs together and write the result into `folder`, whole or not at all.

    monte_carlo : trials to hold the uncertainty against, cut into blocks for `workers`
    """
    # Imported where it computes: the service itself carries no science and no plots.
    from app.jobs.analysis import analyse, read_all, write_analysis

    runs = read_all(run_files, open_recorded)
    shared = nullcontext(map) if monte_carlo is None else opened(workers)
    with shared as mapper:
        analysis = analyse(
            *runs,
            perpendicular_only=perpendicular_only,
            monte_carlo=monte_carlo,
            mapper=mapper,
            progress=progress,
        )
    final = Path(folder)
    part = final.with_name(f"{final.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    write_analysis(analysis, part)
    _sync(part)
    shutil.rmtree(final, ignore_errors=True)
    os.replace(part, final)


def prepare() -> None:
    """Import what an analysis needs, so that the first one does not wait for it."""
    import app.jobs.analysis  # noqa: F401


def _sync(folder: Path) -> None:
    for place in (*folder.iterdir(), folder):
        handle = os.open(place, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
