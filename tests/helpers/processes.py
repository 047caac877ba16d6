"""Waiting for processes and for what they say."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from typing import Any

import psutil


def until(condition: Callable[[], Any], timeout_s: float = 10.0) -> Any:
    """Return what a condition gives once it gives something."""
    deadline_s = time.monotonic() + timeout_s
    while not (met := condition()):
        assert time.monotonic() < deadline_s, "waited in vain"
        select.select([], [], [], 0.02)
    return met


def runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
