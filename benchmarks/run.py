"""Runs the benchmarks: every `bench_*.py` beside this file, or those named.

usage: benchmarks/run.py [NAME ...]
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def benchmarks(names: list[str]) -> list[Path]:
    """Return the scripts that the names ask for; all where none is given."""
    found = {path.stem.removeprefix("bench_"): path for path in HERE.glob("bench_*.py")}
    unknown = sorted(set(names) - set(found))
    if unknown:
        sys.exit(f"no benchmark {', '.join(unknown)}; there are: {', '.join(found)}")
    return [found[name] for name in names or sorted(found)]


def main() -> int:
    """Run them one after another, each in a process of its own; 1 if any failed."""
    failed = [path.name for path in benchmarks(sys.argv[1:]) if not _passes(path)]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def _passes(path: Path) -> bool:
    first_line = path.read_text().splitlines()[0].strip('"')
    print(f"\n== {path.stem.removeprefix('bench_')}: {first_line}", flush=True)
    return subprocess.run([sys.executable, path], check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
