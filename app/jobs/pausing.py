"""Pauses a measurement: the machine is held first, the books follow when they can."""

from __future__ import annotations

from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.cell_supervisor import CellSupervisor
from truepath.app.jobs.errors import StorageUnavailable
from truepath.app.jobs.job import Job
from truepath.app.jobs.transitions import Verb
from truepath.app.measurement.messages import CellVerb


def pause(active: ActiveJob, cell: CellSupervisor) -> Job:
    """Hold the feed, then store that it was asked for.

    The cell gets the command even if it has paused: it might continue by itself.
    Raises IllegalTransition, StorageUnavailable; the cell has been asked even then.
    """
    if active.may_move:
        cell.send(CellVerb.PAUSE)
    try:
        return active.apply_verb(Verb.PAUSE)
    except StorageUnavailable:
        active.keep_pause()
        raise
