"""Events of the service, and the state of a stream across interruptions."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from truepath.client.problems import Unreachable, make_problem
from truepath.client.requests import PREFIX, Answer, parse_json

SILENCE_S = 10.0
"""The service sends a tick every second: a stream silent for so long is broken."""
_PASSING = frozenset({429, 503})
_PAUSES_S = (0.1, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class Event:
    """One event. `id` is that of the last stored one, from which a client resumes."""

    type: str
    data: dict[str, Any]
    id: str = ""


@dataclass(slots=True)
class EventStream:
    """State of a stream, over all its connections.

    last_event_id : of the last stored event that was received
    most_breaks : consecutive failures of connections before it is given up
    """

    job_id: str | None = None
    last_event_id: str = ""
    most_breaks: int = 20
    _breaks: int = field(default=0, init=False)

    @property
    def path(self) -> str:
        """Path of the stream, with the prefix."""
        return f"{PREFIX}/{'' if self.job_id is None else f'jobs/{self.job_id}/'}events"

    @property
    def headers(self) -> dict[str, str]:
        """Headers of the next connection."""
        return {"Last-Event-ID": self.last_event_id} if self.last_event_id else {}

    def receive(self, event_type: str, data: str, event_id: str) -> Event:
        """Decode an event and store its identifier."""
        self._breaks = 0
        self.last_event_id = event_id or self.last_event_id
        return Event(event_type, json.loads(data), self.last_event_id)

    def refuse(self, answer: Answer) -> None:
        """Handle a refusal. Raises its Problem, unless it is temporary."""
        problem = make_problem(
            answer.status, parse_json(answer.body), answer.headers.get("retry-after")
        )
        if answer.status not in _PASSING:
            raise problem

    def count_break(self, reason: str) -> float:
        """Time to wait before the stream is opened again.

        Raises Unreachable where it broke too often without an event between.
        """
        self._breaks += 1
        if self._breaks > self.most_breaks:
            raise Unreachable(f"no events any more: {reason}")
        return _PAUSES_S[min(self._breaks, len(_PAUSES_S)) - 1]
