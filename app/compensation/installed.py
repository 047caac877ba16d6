"""The formats that are installed, ours and others', by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from truepath.app.compensation.axis_choices import split_by_axis
from truepath.app.compensation.format import CompensationFormat
from truepath.app.errors import BadInput
from truepath.app.plugins import find_plugins, load

GROUP = "truepath.compensation_formats"


def load_format(
    name: str, choices: Mapping[str, str] | None = None
) -> CompensationFormat:
    """Return an installed format.

    choices : what of the format's `choices` is wanted, the usual for the others

    Raises BadInput, which tells what is installed, or what may be chosen.
    """
    make = load(GROUP, name)
    for key, word in (choices or {}).items():
        known = make.choices.get(key)
        if known is None:
            given = ", ".join(make.choices) or "nothing to choose"
            raise BadInput(f"the format {name} has no choice of {key}; it has {given}")
        stated = key in make.by_axis and split_by_axis(word, known)
        if not stated and word not in known:
            raise BadInput(f"{key} of {name}: {word!r} is none of {', '.join(known)}")
    return make(**(choices or {}))


def list_formats() -> dict[str, CompensationFormat]:
    """Return every installed format, in the order of their names."""
    installed = find_plugins(GROUP)
    return {name: installed[name].load()() for name in sorted(installed)}


def describe_format(name: str, kind: CompensationFormat) -> dict[str, Any]:
    """Return what a format carries, its bounds, and where its sign is from."""
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
