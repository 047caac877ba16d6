"""How a command that computes sets up its process."""

from __future__ import annotations

import gc


def compute_on_one_thread() -> None:
    """Keep linear algebra to one thread; call it before NumPy is imported.

    On busy cores the threads of a BLAS wait for each other and take several times the
    processor time of one.
    """
    from app.child_process import limit_own_threads

    limit_own_threads()
    # Imports make many objects that stay; looking through them again and again for
    # cycles costs a command that soon ends a twentieth of its time.
    gc.set_threshold(100_000, 50, 50)
