"""Drivers, effects, formats and simulators by entry point; ours the same way.

Each is loaded and called separately. One that fails is omitted from lists, and naming
it raises an error with plug-in, distribution and remedy.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import EntryPoint, distributions, entry_points
from typing import Any, TypeVar

from truepath.errors import BadInput, TruepathError

log = logging.getLogger(__name__)

T = TypeVar("T")
REMEDY = "update, replace or remove that package"
PLAIN_NAME = re.compile(r"\w[\w.-]*", re.ASCII)
left_out = set[str]()
"""Reasons for which plug-ins were omitted from lists of this process so far."""


@dataclass(frozen=True, slots=True)
class PluginOrigin:
    """Plug-in of an object.

    interface_version : of the interface that it implements, 0 where it gives none
    """

    name: str
    distribution: str
    version: str
    interface_version: int


class PluginFailed(BadInput):
    """A plug-in fails to load, to run as agreed, or to give a valid answer."""


def find_plugins(group: str) -> dict[str, EntryPoint]:
    """Installed plug-ins of an entry-point group, by name; ours first."""
    try:
        points = list(entry_points(group=group))
    except Exception:  # a distribution whose list is broken hides no other's
        points = [point for each in _read_lists() for point in each.select(group=group)]
    found: dict[str, EntryPoint] = {}
    for point in sorted(points, key=is_ours):
        if PLAIN_NAME.fullmatch(point.name):  # folders bear it
            found[point.name] = point
        else:
            _leave_out(f"{describe_plugin(point)} has no plain name; {REMEDY}")
    return found


def _read_lists() -> Iterator[Any]:
    for distribution in distributions():
        try:
            yield distribution.entry_points
        except Exception as error:
            text = f"the list of plug-ins of {distribution.name} is broken ({error})"
            _leave_out(f"{text}; {REMEDY}")


def is_ours(point: EntryPoint) -> bool:
    """Whether a plug-in is part of Truepath."""
    return point.value.startswith("truepath.")


def load(group: str, name: str) -> Any:
    """Factory of a plug-in. Raises BadInput listing the installed ones."""
    return load_point(find_point(group, name))


def find_point(group: str, name: str) -> EntryPoint:
    """Plug-in of a name. Raises BadInput listing the installed ones."""
    known = find_plugins(group)
    if name not in known:
        raise BadInput(
            f"no {group.removeprefix('truepath.')} called {name!r} is installed; "
            f"installed: {', '.join(sorted(known)) or 'none'}"
        )
    return known[name]


def load_point(point: EntryPoint) -> Any:
    """Factory of a plug-in. Raises PluginFailed."""
    with guarding(point, "being loaded"):
        return point.load()


def gather(group: str, ask: Callable[[str, Any], T]) -> dict[str, T]:
    """Answers of the plug-ins of a group by name, without those that fail.

    ask : called with name and factory
    """
    found: dict[str, T] = {}
    for name, point in sorted(find_plugins(group).items()):
        try:
            with guarding(point, "being asked what it is"):
                found[name] = ask(name, load_point(point))
        except TruepathError as error:
            _leave_out(str(error))
    return found


def _leave_out(why: str) -> None:
    if why not in left_out:
        left_out.add(why)
        log.warning("left out: %s", why)


def describe_plugin(point: EntryPoint) -> str:
    """Plug-in with its distribution and version, as text."""
    by = f" of {point.dist.name} {point.dist.version}" if point.dist else ""
    return f"{point.group.removeprefix('truepath.')} plug-in {point.name!r}{by}"


def find_origin(point: EntryPoint, made: object) -> PluginOrigin:
    """Origin of a plug-in. made : by it, or its factory."""
    stated = getattr(made, "interface_version", 0)
    return PluginOrigin(
        point.name,
        point.dist.name if point.dist else "",
        point.dist.version if point.dist else "",
        stated if isinstance(stated, int) else 0,
    )


def word_error(error: BaseException) -> str:
    """Foreign error as text, even if its own conversion fails."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:
        return type(error).__name__


@contextmanager
def guarding(point: EntryPoint, call: str) -> Iterator[None]:
    """Turn errors of a plug-in, except those of the service, into PluginFailed."""
    try:
        yield
    except TruepathError:
        raise
    except (Exception, SystemExit) as error:
        text = f"{describe_plugin(point)} has failed in {call} ({word_error(error)})"
        raise PluginFailed(f"{text}; {REMEDY}") from error


class Guarded:
    """Object made by a foreign plug-in; its failures are PluginFailed.

    check : takes the name of a call and its answer, gives the value to pass on; raises
        ValueError. The name of a call of such an answer is `NAME()`
    """

    def __init__(
        self, made: object, point: EntryPoint, check: Callable[[str, Any], Any]
    ) -> None:
        self._made, self._point, self._check = made, point, check

    @property
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Class of the guarded object, for `isinstance`."""
        return type(self._made)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        with guarding(self._point, name):
            value = getattr(self._made, name)
        return self._wrap(name, value) if callable(value) else value

    def _wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            with guarding(self._point, f"{name}()"):
                answer = self._check(name, function(*arguments, **named))
            return self._wrap(f"{name}()", answer) if callable(answer) else answer

        return call
