"""Events of the service, and what a client knows of its stream when it breaks."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from truepath.client.problems import Unreachable, make_problem
from truepath.client.requests import PREFIX, Answer, parse_json

SILENCE_S = 10.0
"""The service ticks every second: a stream that is silent for so long is broken."""
_PASSING = frozenset({429, 503})
_PAUSES_S = (0.1, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class Event:
    """One event. `id` is that of the last kept one, by which a client catches up."""

    type: str
    data: dict[str, Any]
    id: str = ""


@dataclass(slots=True)
class EventStream:
    """Where a stream is, over all its connections.

    last_event_id : of the last kept event that was received
    most_breaks : connections that may fail one after another before it is given up
    """

    job_id: str | None = None
    last_event_id: str = ""
    most_breaks: int = 20
    _breaks: int = field(default=0, init=False)

    @property
    def path(self) -> str:
        """The address of the stream."""
        return f"{PREFIX}/{'' if self.job_id is None else f'jobs/{self.job_id}/'}events"

    @property
    def headers(self) -> dict[str, str]:
        """What a connection is opened with."""
        return {"Last-Event-ID": self.last_event_id} if self.last_event_id else {}

    def receive(self, event_type: str, data: str, event_id: str) -> Event:
        """Take an event."""
        self._breaks = 0
        self.last_event_id = event_id or self.last_event_id
        return Event(event_type, json.loads(data), self.last_event_id)

    def refuse(self, answer: Answer) -> None:
        """Take a refusal. Raises its Problem, unless it passes by itself."""
        problem = make_problem(
            answer.status, parse_json(answer.body), answer.headers.get("retry-after")
        )
        if answer.status not in _PASSING:
            raise problem

    def count_break(self, reason: str) -> float:
        """Return how long to wait before the stream is opened again.

        Raises Unreachable where it broke too often without an event between.
        """
        self._breaks += 1
        if self._breaks > self.most_breaks:
            raise Unreachable(f"no events any more: {reason}")
        return _PAUSES_S[min(self._breaks, len(_PAUSES_S)) - 1]
