"""Runs the validation: every script beside this file that has a `main`, or those named.

usage: validation/run.py [NAME ...]
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path

SCRIPTS = (
    "paper_2005_single_spline",
    "paper_2005_stacked_splines",
    "paper_2023_simulation",
    "paper_2023_feeds",
    "paper_2023_direct_measurement",
    "random_machines",
    "instrument_errors",
    "compensation_tables",
    "rotary_compensation",
    "large_machines",
    "along_the_path",
    "forecasts",
    "fast_machines",
    "disturbed_runs",
    "wrong_programs",
    "target_seats",
    "five_axes",
    "five_axes_in_motion",
    "verified_compensation",
)


def main() -> int:
    """Run them one after another; 2 where a name is unknown."""
    names = sys.argv[1:] or list(SCRIPTS)
    unknown = sorted(set(names) - set(SCRIPTS))
    if unknown:
        print(f"no {', '.join(unknown)}; there are: {', '.join(SCRIPTS)}")
        return 2
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    for name in names:
        module = importlib.import_module(name)
        print(f"\n== {name}: {(module.__doc__ or '').splitlines()[0]}", flush=True)
        begin = time.perf_counter()
        module.main()
        print(f"{time.perf_counter() - begin:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
