"""Every form in which the service says what data do not determine, by its code."""

import ast
import inspect
from textwrap import dedent

from truepath.answers import plan_report
from truepath.estimation.problem import observability
from truepath.kinematics import identifiable

_NAMES = "EXZ, EYZ"
_WORDS = """the a an of to and or not with it its is are be by on from this that cannot
does tool target targets lines points shows show them other further second"""
ENGLISH = frozenset(_WORDS.split())


def list_unobservable():
    """Yield every form in which the service says what data do not determine."""
    head = "ECZ (roll of Z)"
    merged = f"{head} is not distinguishable from EXZ and EYZ with one tool length"
    for said in (merged, f"{head} does not move the target"):
        for cure in observability._TRIALS:
            for length in ("", " at least 140 mm"):
                asked = f"a second {cure.format(length)}"
                yield from _fill(observability._statement, said, asked)
    yield from _fill(identifiable.Confounded.__str__, head, "")
    yield from _fill(plan_report._list_unobservable, "B, C", "")
    yield from _fill(observability._blind_shapes, _NAMES, "")


def _fill(function, said, asked):
    """Yield the sentences that a function puts together, with these in their blanks."""
    blanks = {"said": said, "named": said, "axes": said, "does": "shows it"}
    blanks["many"] = "2 common shapes are"
    for node in ast.walk(ast.parse(dedent(inspect.getsource(function)))):
        if not isinstance(node, ast.JoinedStr) or len(ast.unparse(node)) < 45:
            continue
        parts = []
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                blank = ast.unparse(part.value)
                parts.append(blanks.get(blank, asked if "asked" in blank else _NAMES))
            elif isinstance(part, ast.Constant):
                parts.append(str(part.value))
        if parts[0] == said:
            yield "".join(parts)
