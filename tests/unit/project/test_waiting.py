"""Nothing waits for real time, or reads it, but where that is its subject."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[3]
ROOMS = ("app/truepath", "drivers/truepath_drivers")
REAL = {
    "drivers/truepath_drivers/host_clock.py": "is the clock",
    "drivers/truepath_drivers/cnc/linuxcnc/truepath_watchdog.py": "runs in LinuxCNC",
    "drivers/truepath_drivers/tracker/bridge": "is copied beside the SDK of a maker",
    "drivers/truepath_drivers/transport": "ports wait for bytes; tests replace them",
    "drivers/truepath_drivers/conformance": "holds devices of iron to their times",
    "app/truepath/client": "runs in programs of others",
    "app/truepath/cli/demo.py": "hears another process",
    "app/truepath/service/api": "its event loop waits for sockets",
    "app/truepath/child_process.py": "processes end in real time",
    "app/truepath/measurement/process": "watches processes",
    "app/truepath/jobs/running/live_estimation.py": "hears another process",
    "app/truepath/jobs/running/live_process.py": "hears another process",
    "app/truepath/machines/cell_supervisor.py": "hears another process",
    "app/truepath/jobs/workers": "waits for processes, and for Dask by its own means",
    "app/truepath/catalogue/postgres_connection.py": "psycopg waits by itself",
    "app/truepath/users/access.py": "bounds how many hash passwords at once",
}
WAITS = {"wait", "wait_for", "join", "get", "put", "result", "acquire"}
WAITS |= {"poll", "settimeout"}
CLOCKS = {"monotonic", "monotonic_ns", "time", "time_ns", "sleep", "perf_counter"}


def waits_for_real_time(node):
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    owner, name = ast.unparse(node.func.value), node.func.attr
    if owner == "time" and name in CLOCKS:
        return True
    if owner in ("host_clock", "client", "self") or name not in WAITS:
        return False
    named = {word.arg for word in node.keywords}
    if named & {"timeout", "timeout_s"}:
        return True
    words = [ast.unparse(argument).lower() for argument in node.args]
    if name not in ("get", "put") and any(word.endswith("_s") for word in words):
        return True
    if name in ("poll", "settimeout") and node.args:
        return True
    return owner == "asyncio" and name.startswith("wait")


def test_only_what_is_about_real_time_waits_for_it():
    files = [file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    assert len(files) > 400
    found, allowed = [], set()
    for file in files:
        name = file.relative_to(ROOT).as_posix()
        nodes = ast.walk(ast.parse(file.read_text()))
        lines = [node.lineno for node in nodes if waits_for_real_time(node)]
        place = next((p for p in REAL if name == p or name.startswith(f"{p}/")), None)
        if place is None:
            found += [f"{name}:{line}" for line in lines]
        elif lines:
            allowed.add(place)
    assert not found, "wait by truepath_drivers.host_clock"
    assert set(REAL) == allowed, "these need not be on the list"
