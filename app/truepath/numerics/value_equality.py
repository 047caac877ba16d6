"""Equality and hash of dataclasses that hold arrays."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, cast

import numpy as np

_CONTENT = "_content_of_fields"


class ValueEquality:
    """Dataclasses of one class are equal if their fields are, arrays by content.

    Subclasses need no `eq=False`: the decorator keeps the methods defined here.
    """

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Define both in each subclass, so that the dataclass decorator adds none."""
        super().__init_subclass__(**arguments)
        for name in ("__eq__", "__hash__"):
            if name not in cls.__dict__:
                setattr(cls, name, getattr(ValueEquality, name))

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, ValueEquality)
            and type(self) is type(other)
            and self._content() == other._content()
        )

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> Any:
        """Computed once where the class has a `__dict__`."""
        room = getattr(self, "__dict__", {})
        if _CONTENT not in room:
            room[_CONTENT] = hashable(self)
        return room[_CONTENT]


def hashable(value: Any) -> Any:
    """Key for comparing and hashing a value: arrays and records by their content."""
    if isinstance(value, np.ndarray):
        array = cast("np.ndarray[Any, Any]", value)
        return array.shape, array.tobytes()
    if isinstance(value, dict):
        content = cast("dict[Any, Any]", value)
        return tuple((key, hashable(each)) for key, each in content.items())
    if isinstance(value, tuple):
        return tuple(map(hashable, cast("tuple[Any, ...]", value)))
    if is_dataclass(value):
        return type(value), *(hashable(getattr(value, f.name)) for f in fields(value))
    return value
