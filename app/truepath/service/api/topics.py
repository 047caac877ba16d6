"""Events of a stream: all, or those of named jobs and machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from truepath.catalogue.job import Job, JobEvent
from truepath.errors import BadInput, NotFound

FindMachine = Callable[[str], str | None]
"""Machine of an active job, without waiting; None where unknown."""

MOST_TOPICS = 32


@dataclass(frozen=True, slots=True)
class Topics:
    """Selected events; without jobs and machines all.

    jobs, machines : identifiers; a machine includes its jobs
    """

    jobs: frozenset[str] = frozenset()
    machines: frozenset[str] = frozenset()

    @property
    def is_all(self) -> bool:
        """Whether nothing is excluded."""
        return not self.jobs and not self.machines

    @property
    def only_job(self) -> str | None:
        """The job, where it is the only topic."""
        (job_id,) = self.jobs if len(self.jobs) == 1 else (None,)
        return None if self.machines else job_id

    def includes_job(self, job: Job) -> bool:
        """Whether a job is selected."""
        return self.is_all or job.id in self.jobs or job.machine in self.machines

    def includes_event(self, event: JobEvent, find_machine: FindMachine) -> bool:
        """Whether an event is selected. Never waits."""
        if self.is_all or event.job_id in self.jobs:
            return True
        machine = event.body.get("machine")
        if event.job_id is not None and machine is None and self.machines:
            machine = find_machine(event.job_id)
        return machine in self.machines


def parse_topics(
    text: str,
    require_job: Callable[[str], object],
    require_machine: Callable[[str], object],
) -> Topics:
    """Topics of `job:ID,machine:ID`; all for an empty text.

    require_job, require_machine : raise NotFound where there is none

    Raises BadInput naming the topic.
    """
    named: dict[str, set[str]] = {"job": set(), "machine": set()}
    require = {"job": require_job, "machine": require_machine}
    topics = [topic.strip() for topic in text.split(",")] if text else []
    if len(topics) > MOST_TOPICS:
        raise BadInput(f"topics: {len(topics)} are named; at most {MOST_TOPICS} can be")
    for topic in topics:
        kind, _, identifier = topic.partition(":")
        if kind not in named or not identifier:
            raise BadInput(
                f"topics: {topic[:80]!r} is unknown; name job:ID or machine:ID, "
                "separated by commas, or leave topics out"
            )
        try:
            require[kind](identifier)
        except NotFound as error:
            raise BadInput(f"topics: {topic[:80]!r} is unknown: {error}") from error
        named[kind].add(identifier)
    return Topics(frozenset(named["job"]), frozenset(named["machine"]))
