"""Something that a tracker takes its time for, while the engine goes on looking."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class TrackerTask:
    """A verb of a tracker under way, in a thread of its own. Begins at once.

    answer : of the verb, once it is over; failure : why it was not done
    """

    def __init__(self, verb: Callable[[], Any]) -> None:
        self._verb = verb
        self.answer: Any = None
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="tracker", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether it is done, or has failed."""
        return not self._thread.is_alive()

    def wait(self, timeout_s: float) -> None:
        """Wait for its end, at most so long."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        """Body of the thread."""
        try:
            self.answer = self._verb()
        except Exception as error:
            self.failure = error
