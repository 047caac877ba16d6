"""The options of drivers, checked against each driver's signature.

They are the parameters of its factory, with names, types and defaults; settings are
checked against them before anything is opened.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_type_hints

from pydantic import PydanticSchemaGenerationError, TypeAdapter, ValidationError

from truepath.driver_border import guard
from truepath.errors import BadInput
from truepath.plugins import find_point, guarding, load, load_point
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.thermometers import Thermometers
from truepath_drivers.interfaces.tracker import PolledTracker, Tracker

REQUIRED = inspect.Parameter.empty
DEVICES = {
    "tracker": "truepath.trackers",
    "motion": "truepath.motion_controllers",
    "thermometer": "truepath.thermometers",
}
"""Entry-point groups of drivers, by the prefix of their settings."""
_INTERFACES: Mapping[str, tuple[type, ...]] = {
    "tracker": (Tracker, PolledTracker),
    "motion": (MotionController,),
    "thermometer": (Thermometers,),
}


@dataclass(frozen=True, slots=True)
class DriverOption:
    """An option of a driver.

    kind : its type as text; default : REQUIRED where it has to be given
    """

    name: str
    kind: str
    default: object

    @property
    def is_required(self) -> bool:
        """Whether there is no default."""
        return self.default is REQUIRED


def list_options(group: str, name: str) -> tuple[DriverOption, ...]:
    """Options of a driver. Raises BadInput if it is not installed."""
    return read_options(name, load(group, name))


def read_options(_name: str, factory: Any) -> tuple[DriverOption, ...]:
    """Options from the signature of a driver's factory."""
    return tuple(
        DriverOption(one.name, _name_kind(one.annotation), one.default)
        for one in _parameters(factory)
        if one.kind is not inspect.Parameter.VAR_KEYWORD
    )


def make_device(
    word: str,
    name: str,
    options: Mapping[str, Any],
    limits_s: Mapping[str, float] | None = None,
) -> Any:
    """Unconnected device of a driver, with its options checked.

    word : `tracker`, `motion` or `thermometer`; limits_s : as in `guard`

    Raises BadInput naming setting, value and remedy for an unknown driver or option,
    one that is missing, and one of the wrong type; PluginFailed if it makes none.
    """
    point = find_point(DEVICES[word], name)
    factory = load_point(point)
    place = f"{word}_options of driver {name}"
    with guarding(point, "being asked for its options"):
        parameters = {one.name: one for one in _parameters(factory)}
        hints = _read_hints(factory)
    takes_any = any(one.kind is one.VAR_KEYWORD for one in parameters.values())
    for key in options:
        if key not in parameters and not takes_any:
            near = get_close_matches(key, parameters, 1)
            remedy = f"did you mean {near[0]}?" if near else ""
            known = ", ".join(parameters) or "none"
            raise BadInput(f"{place}: {key!r} is unknown; {remedy} it takes {known}")
    for one in parameters.values():
        is_named = one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)
        if is_named and one.default is REQUIRED and one.name not in options:
            kind = _name_kind(one.annotation)
            raise BadInput(f"{place}: {one.name!r} is missing; give it ({kind})")
    kept = {
        key: _validate(value, hints[key], f"{place}: {key}") if key in hints else value
        for key, value in options.items()
    }
    with guarding(point, "being made"):
        try:
            device = factory(**kept)
        except (ValueError, Refused) as error:
            raise BadInput(f"{place}: {error}") from error
        if not isinstance(device, _INTERFACES[word]):
            raise TypeError(f"{type(device).__name__} is no {word}")
    return guard(device, point, limits_s)


def _parameters(factory: Any) -> list[inspect.Parameter]:
    return list(inspect.signature(factory).parameters.values())


def _read_hints(factory: Any) -> dict[str, Any]:
    """Empty where annotations cannot be resolved."""
    function = factory.__init__ if inspect.isclass(factory) else factory
    try:
        return get_type_hints(function)
    except (NameError, TypeError):
        return {}


def _validate(value: Any, kind: Any, place: str) -> Any:
    try:
        return TypeAdapter(kind).validate_python(value)
    except PydanticSchemaGenerationError:
        return value
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        inner = "".join(f"[{part!r}]" for part in first["loc"] if part != kind)
        raise BadInput(
            f"{place}{inner} is {first['input']!r}: {first['msg'].lower()}; "
            f"expected {_name_kind(kind)}"
        ) from None


def _name_kind(kind: Any) -> str:
    if isinstance(kind, str):
        return kind
    return getattr(kind, "__name__", str(kind)) if kind is not REQUIRED else "any"
