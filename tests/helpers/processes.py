"""Waiting for processes and for what they say."""

import time

import psutil


def until(condition, timeout_s=10.0):
    deadline_s = time.monotonic() + timeout_s
    while not (met := condition()):
        assert time.monotonic() < deadline_s, "waited in vain"
        time.sleep(0.01)
    return met


def runs(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
