"""How many small faults the tests notice: one at a time in a copy of the tree.

Each room that decides gets an equal share of random faults: a comparison turned, a
sign, an `and`, a number. It counts as noticed once a test of its room, or of one that
builds on it, fails or hangs.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).parent.parent
ROOMS = {  # and the rooms whose tests are run, in their order
    "app/truepath/estimation": ["estimation", "results", "answers"],
    "app/truepath/alignment": ["alignment", "estimation", "results"],
    "app/truepath/discovery": ["discovery", "answers", "validation"],
    "app/truepath/measurement": ["measurement", "jobs", "faults"],
    "app/truepath/motion": ["motion", "planning", "measurement"],
    "drivers/truepath_drivers": ["drivers", "measurement"],
    "app/truepath/jobs": ["jobs", "operation", "service"],
    "app/truepath/compensation": ["compensation", "cli"],
}
KINDS = "unit", "system"
HUNG, UNKNOWN = "a test that hung", "what collects the tests"
LEFT_OUT = ".venv", ".git", "var", "__pycache__", ".*_cache", "*.egg-info"
LIMIT_S = 1800.0  # of one room's tests
# Turned round: measured numbers are never just on a limit.
_COMPARED = {ast.Lt: ">=", ast.LtE: ">", ast.Gt: "<=", ast.GtE: "<"}
_COMPARED |= {ast.Eq: "!=", ast.NotEq: "==", ast.Is: "is not", ast.IsNot: "is"}
_COMPARED |= {ast.In: "not in", ast.NotIn: "in"}
_COMPUTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}


@dataclass(frozen=True)
class Mutant:
    """A fault: what stands in a file from `begin` to `end` becomes `text`."""

    room: str
    file: Path
    line: int
    begin: int
    end: int
    text: str

    def show(self):
        before = (ROOT / self.file).read_bytes()[self.begin : self.end].decode()
        return f"{self.file}:{self.line}: {before!r} -> {self.text!r}"


def find_mutants(room, file):
    source = (ROOT / file).read_bytes()  # the syntax tree counts bytes
    starts = [0]
    for row in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(row))
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                for first, last, text in _list_faults(node):
                    begin = starts[first.end_lineno - 1] + first.end_col_offset
                    end = starts[last.lineno - 1] + last.col_offset
                    if first is last:
                        begin, end = end, begin
                    elif set(source[begin:end]) & set(b"()#\n"):
                        continue  # the operator alone is to be replaced
                    yield Mutant(room, file, first.lineno, begin, end, text)


def _list_faults(node):
    """Return what stands between two expressions, or is one, and its replacement."""
    match node:
        case ast.Compare(left=left, ops=[one], comparators=[right]):
            yield left, right, f" {_COMPARED[type(one)]} "
        case ast.BinOp(left=left, op=one, right=right) if type(one) in _COMPUTED:
            yield left, right, f" {_COMPUTED[type(one)]} "
        case ast.BoolOp(op=one, values=[left, right]):
            yield left, right, " or " if isinstance(one, ast.And) else " and "
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield node, node, f"bool({ast.unparse(operand)})"
        case ast.Constant(value=bool() as value):
            yield node, node, str(not value)
        case ast.Constant(value=int() | float() as value):
            yield node, node, repr(value + 1 if value in (0, 1) else value * 2)
        case _:
            return


def choose(count, seed):
    rng = random.Random(seed)
    chosen = []
    for number, room in enumerate(ROOMS):
        files = sorted((ROOT / room).rglob("*.py"))
        found = {m for f in files for m in find_mutants(room, f.relative_to(ROOT))}
        found = sorted(found, key=lambda mutant: (str(mutant.file), mutant.begin))
        share = (count + number) // len(ROOMS)
        chosen += rng.sample(found, share)
    return chosen


def find_noticing_test(mutant, tree):
    """Run tests in a copy of the tree until one fails or hangs, but not without it."""
    file = tree / mutant.file
    source = file.read_bytes()
    fault = mutant.text.encode()
    file.write_bytes(source[: mutant.begin] + fault + source[mutant.end :])
    folders = [
        tree / "tests" / kind / room for kind in KINDS for room in ROOMS[mutant.room]
    ]
    tests = [str(folder) for folder in folders if folder.is_dir()]
    try:
        failed = find_failure(tree, *tests)
    finally:
        file.write_bytes(source)
    if failed in (None, HUNG, UNKNOWN) or find_failure(tree, failed) is None:
        return failed
    print(f"{failed} fails without any fault", file=sys.stderr)
    return None


def find_failure(tree, *tests):
    roots = [str(tree / root) for root in ("app", "drivers", "simulators")]
    order = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not long"]
    order += ["-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(roots)}
    try:
        done = subprocess.run(
            order, cwd=tree, env=environment, capture_output=True, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return HUNG
    if done.returncode == 0:
        return None
    found = re.search(
        r"^(?:FAILED|ERROR) (tests/.+?)(?: - |$)", done.stdout.decode(), re.M
    )
    return found[1] if found else UNKNOWN


def copy_tree(folder):
    left_out = shutil.ignore_patterns(*LEFT_OUT)
    return Path(shutil.copytree(ROOT, folder / "tree", ignore=left_out))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--noticed", type=int, default=54, help="as many at least")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    mutants = choose(asked.count, asked.seed)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)  # some tests are another user's
        trees = [copy_tree(Path(folder) / str(n)) for n in range(asked.jobs)]

        free = SimpleQueue()
        for tree in trees:
            free.put(tree)

        def try_one(mutant):
            tree = free.get()
            test = find_noticing_test(mutant, tree)
            free.put(tree)
            print(mutant.show(), "is noticed by", test or "none", flush=True)
            return test is not None

        with ThreadPoolExecutor(asked.jobs) as pool:
            noticed = sum(pool.map(try_one, mutants))
    print(f"{noticed} of {len(mutants)} faults were noticed")
    sys.exit(noticed < asked.noticed)


if __name__ == "__main__":
    main()
