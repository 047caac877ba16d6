"""Discovery on worlds with hidden effects: right names, false alarms, gap.

Outcomes are kept as lines of JSON, one a world, so that a draw continues where it
stopped; `--fresh` starts again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from discovery_score import Outcome, as_row, assess_discovery, from_row
from discovery_summary import (
    confusion_table,
    hard_table,
    list_missed_marks,
    marks_table,
    parameter_table,
    size_table,
    summarise,
)
from document import write_section
from draws import keep_rows, make_parser, read_rows
from hidden_worlds import draw_world

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "discovery.md"
KEPT = ROOT / "var" / "discovery-worlds.jsonl"
COUNTS = {
    "single": 192,
    "pair": 60,
    "clean": 100,
    "off-catalogue": 90,
    "triple": 36,
    "tenth": 36,
    "tenfold": 36,
    "rough-stream": 36,
    "poor-hall": 36,
    "standstill": 40,
}
# Of worlds that the method is never improved on: the tables are of these alone.
REPORTED = 60_000

Task = tuple[int, str]


def draw_tasks(counts: dict[str, int], first: int = 0) -> list[Task]:
    """Return seed and kind of every world; kinds take turns."""
    tasks = [
        (first + 1000 * number + k, kind, k / count)
        for number, (kind, count) in enumerate(counts.items(), 1)
        for k in range(count)
    ]
    return [(seed, kind) for seed, kind, _ in sorted(tasks, key=lambda t: t[2])]


def judge_world(task: Task) -> Outcome:
    """Draw a world, run discovery on it, and judge the answer."""
    return assess_discovery(draw_world(*task))


def judge_worlds(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Yield the outcomes in the order of the tasks."""
    if jobs == 1:
        yield from map(judge_world, tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(judge_world, tasks)


def describe(o: Outcome) -> str:
    before, after, floor = o.gap_um
    hidden = ", ".join(o.truth) or "nothing"
    said = ", ".join(o.said) or "nothing"
    said += f" (possible: {', '.join(o.possible)})" if o.possible else ""
    beside = f"; unnamed: {'; '.join(o.unnamed)}" if o.unnamed else ""
    sizes = " ".join(f"{s:.0f}" for s in o.signal_to_noise)
    return (
        f"{'ok  ' if o.right else 'FAIL'} {o.kind:13s} {o.seed}  hidden: {hidden}"
        f" (S/N {sizes or '-'})  said: {said}{beside}"
        f"  gap {before:.2f} -> {after:.2f}, floor {floor:.2f} µm  {o.took_s:.0f} s"
    )


def main() -> None:
    """Judge the missing worlds, write the tables; exit 1 if a mark is missed."""
    options, _ = _parser().parse_known_args()
    counts = {kind: max(1, round(options.share * n)) for kind, n in COUNTS.items()}
    tasks = draw_tasks(counts, 0 if options.improve else REPORTED)
    if options.fresh:
        options.kept.unlink(missing_ok=True)
    done = {(o.seed, o.kind): o for o in map(from_row, read_rows(options.kept))}
    missing = [task for task in tasks if task not in done][: options.most]
    rows = map(as_row, judge_worlds(missing, options.jobs))
    for one in map(from_row, keep_rows(options.kept, rows)):
        done[one.seed, one.kind] = one
        print(describe(one), flush=True)
    found = [done[task] for task in tasks if task in done]
    if not options.improve:
        _write(found)
    missed = list_missed_marks(summarise(found))
    print(*missed, sep="\n")
    sys.exit(bool(missed))


def _write(found: Sequence[Outcome]) -> None:
    for name, make in (
        ("discovery-marks", marks_table),
        ("discovery-hard", hard_table),
        ("discovery-confusion", confusion_table),
        ("discovery-sizes", size_table),
        ("discovery-parameters", parameter_table),
    ):
        write_section(name, make(found), DOCUMENT)


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(__doc__, KEPT)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--fresh", action="store_true", help="forget earlier outcomes")
    return parser


if __name__ == "__main__":
    main()
