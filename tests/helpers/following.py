"""A Run as the live estimate follows it, block by block."""

from dataclasses import dataclass, field, replace

import numpy as np

from truepath.estimation.checks.change_detection import Notice
from truepath.estimation.live.live import LiveEstimate, LiveEstimator
from truepath.files.bundle.run import PointBlock, PointRows
from truepath.results.error_tables import build_error_tables


@dataclass
class Followed:
    """The estimates on the way and the last; what was noticed when each was made."""

    live: LiveEstimator
    on_the_way: list[LiveEstimate] = field(default_factory=list)
    noticed: list[tuple[float, tuple[Notice, ...]]] = field(default_factory=list)
    last: LiveEstimate | None = None


def follow(run, *, blocks=None, with_notices=False, **options):
    """Give a Run to the live estimate in blocks, of 20 samples if none are given."""
    followed = Followed(LiveEstimator(run.machine, run.commanded, **options))
    for block in blocks or list_blocks(run):
        if not followed.live.add_block(block):
            continue
        now = followed.live.estimate()
        if now is not None:
            followed.on_the_way.append(now)
        if now is not None and with_notices:
            time_s = float(block.device_time_s[-1])
            followed.noticed.append((time_s, followed.live.list_notices()))
    followed.live.finish()
    followed.last = followed.live.estimate()
    return followed


def follow_lines(run):
    return follow(run, blocks=list_blocks(run, 100), with_notices=True)


def list_blocks(run, size=20):
    begins = range(0, len(run.tracker), size)
    return [run.tracker.select(slice(begin, begin + size)) for begin in begins]


def list_point_blocks(run):
    points = run.points
    columns = points.row, points.count, points.covariance_mm2
    ones = (slice(k, k + 1) for k in range(len(run.tracker)))
    rows = (PointRows(*(column[one] for column in columns)) for one in ones)
    return list(map(PointBlock, list_blocks(run, 1), rows))


def shift(run, shift_mm):
    """Return a Run whose samples (n,) lie elsewhere by (n, 3)."""
    moved = run.tracker.position_mm + shift_mm
    return replace(run, tracker=replace(run.tracker, position_mm=moved))


def compare_tables(found, expected):
    """Return how far tables are off those of another estimate, in u."""
    tables, off = build_error_tables(found), []
    for one in build_error_tables(expected).tables:
        apart = tables.table(one.symbol).value - one.value
        off.append(apart / np.maximum(one.uncertainty, 0.05))
    return np.concatenate(off)
