"""One thread of linear algebra a process, in every command."""

import os
import subprocess
import sys

import pytest

COMMAND = """
import os, sys
from truepath.cli.command import main
assert "numpy" not in sys.modules
sys.argv = ["truepath", "--version"]
try:
    main()
except SystemExit:
    import numpy
    print(os.environ["OPENBLAS_NUM_THREADS"], len(os.listdir("/proc/self/task")))
"""


@pytest.mark.parametrize(("set_by_user", "threads"), [({}, 1), ({"OMP": 2}, 2)])
def test_a_command_computes_on_one_thread_or_as_many_as_are_set(set_by_user, threads):
    kept = {name: v for name, v in os.environ.items() if "_NUM_THREADS" not in name}
    kept |= {f"{name}_NUM_THREADS": str(n) for name, n in set_by_user.items()}
    words = [sys.executable, "-c", COMMAND]
    said = subprocess.check_output(words, env=kept, text=True)
    number, running = map(int, said.split()[-2:])
    assert number == threads
    assert running == min(threads, len(os.sched_getaffinity(0)))
