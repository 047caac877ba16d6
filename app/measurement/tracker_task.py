"""Something that a tracker takes its time for, while the engine goes on looking."""

from __future__ import annotations

import threading
from collections.abc import Callable


class TrackerTask:
    """A verb of a tracker under way, in a thread of its own. Begins at once.

    failure : why it was not done
    """

    def __init__(self, verb: Callable[[], None]) -> None:
        self._verb = verb
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="tracker", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether it is done, or has failed."""
        return not self._thread.is_alive()

    def _run(self) -> None:
        """Body of the thread."""
        try:
            self._verb()
        except Exception as error:
            self.failure = error
