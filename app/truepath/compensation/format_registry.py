"""Installed formats by name, ours and third-party."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from truepath.compensation.format import CompensationFormat, split_by_axis
from truepath.errors import BadInput
from truepath.plugins import (
    Guarded,
    find_point,
    gather,
    guarding,
    is_ours,
    load_point,
)

GROUP = "truepath.compensation_formats"
_PLAIN_NAME = re.compile(r"\w[\w.-]*", re.ASCII)
_NO_NUMBER = re.compile(r"(?<![a-z])(nan|inf|infinity)(?![a-z])", re.IGNORECASE)


def load_format(
    name: str, choices: Mapping[str, str] | None = None
) -> CompensationFormat:
    """Raises BadInput that lists the installed formats or the possible choices.

    choices : words for some of the format's `choices`; defaults for the others
    """
    point = find_point(GROUP, name)
    make = load_point(point)
    for key, word in (choices or {}).items():
        known = make.choices.get(key)
        if known is None:
            given = ", ".join(make.choices) or "nothing to choose"
            raise BadInput(f"the format {name} has no choice of {key}; it has {given}")
        stated = key in make.by_axis and split_by_axis(word, known)
        if not stated and word not in known:
            raise BadInput(f"{key} of {name}: {word!r} is none of {', '.join(known)}")
    if is_ours(point):
        return make(**(choices or {}))
    with guarding(point, "being made"):
        return cast(Any, Guarded(make(**(choices or {})), point, _check))


def list_formats() -> dict[str, CompensationFormat]:
    """Every installed format, in the order of their names."""
    return gather(GROUP, _check_format)


def _check_format(name: str, make: Any) -> CompensationFormat:
    kind = make()
    told = describe_format(name, kind)
    texts = [told[key] for key in ("control", "carries", "not_carried", "note")]
    "".join([*texts, told["sign"]["rule"], *told["choices"], *told["by_axis"]])
    "".join(word for words in told["choices"].values() for word in words)
    if not 2 <= told["most_rows"] < np.inf or not 0.0 < told["resolution_um"] < np.inf:
        raise ValueError("its most_points or resolution_um is no such number")
    return kind


def _check(call: str, answer: Any) -> Any:
    if call == "write":
        if not answer:
            raise ValueError("it has written no file")
        for name, text in answer.items():
            if _PLAIN_NAME.fullmatch(name) is None:
                raise ValueError(f"{name!r} is no plain file name")
            text.encode("ascii")
            if odd := _NO_NUMBER.search(text):
                raise ValueError(f"{name} has {odd.group()} in it")
    elif call == "read()":  # the correction
        added = np.asarray(answer, np.float64)
        if added.ndim != 2 or added.shape[1] != 3 or not np.isfinite(added).all():
            raise ValueError("its correction is not three finite numbers a position")
    return answer


def describe_format(name: str, kind: CompensationFormat) -> dict[str, Any]:
    """Content of a format, its limits, and the source of its sign."""
    return {
        "name": name,
        "control": kind.control,
        "carries": kind.carries,
        "not_carried": kind.not_carried,
        "most_rows": kind.most_points,
        "resolution_um": kind.resolution_um,
        "sign": {"rule": kind.sign, "verified": kind.sign_is_verified},
        "note": kind.note,
        "choices": {key: list(words) for key, words in kind.choices.items()},
        "by_axis": list(kind.by_axis),
    }
