"""The border of the service to a driver: time limits and valid answers.

Each call is made in a separate thread, and the caller waits no longer than the service
allows, whatever the driver promises. Errors other than device errors, and invalid
answers, become one DriverFault that names the call.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from truepath.plugins import (
    REMEDY,
    PluginOrigin,
    describe_plugin,
    find_origin,
    word_error,
)
from truepath_drivers import host_clock
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.device import Device
from truepath_drivers.interfaces.errors import DeviceError, DriverFault
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    Identity,
    LinkHealth,
    MotionStatus,
    TrackerSamples,
)
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers
from truepath_drivers.interfaces.tracker_records import (
    Air,
    PointMeasurement,
    TrackerCapabilities,
    TrackerEvent,
)

D = TypeVar("D", bound=Device)

QUICK_S = 3.0  # for what is asked for while a machine moves, or must stop
_LIMITS_S = {"connect": 15.0, "start": 10.0, "stop": 5.0, "close": 5.0}
_LOAD_S, _LOAD_ROW_S = 30.0, 0.5
_POINT_S = 19.0  # beyond its dwell
_Span = Annotated[float, Field(ge=0.0, le=300.0)]  # s
_TURNS = frozenset({"home", "aim", "search", "select_target"})
_STOPS = frozenset({"stop", "hold", "abort", "close"})  # tried whatever else hangs
_PROPERTIES = frozenset(
    {"axes", "travel", "health", "capabilities", "channels", "period_s", "verb_limit_s"}
)
_SLICE_S = 0.25
_KINDS: Mapping[str, Any] = {
    "connect": Identity,
    "status": MotionStatus,
    "wait": MotionStatus,
    "axes": tuple[str, ...],
    "travel": tuple[tuple[float, float], ...],
    "health": LinkHealth,
    "capabilities": TrackerCapabilities,
    "channels": tuple[Channel, ...],
    "period_s": _Span,
    "verb_limit_s": _Span,
    "take_link_bytes": bytes,
    "take_events": tuple[TrackerEvent, ...],
    "read_air": Air,
}
_SHAPES: Mapping[type, Mapping[str, tuple[int, ...]]] = {
    TrackerSamples: {"sequence": (), "device_time_s": (), "position_mm": (3,)}
    | {"status": (), "quality": ()},  # of each sample
    PointMeasurement: {"position_mm": (3,), "covariance_mm2": (3, 3)},
}


class Call:
    """A call in a separate thread. Begins at once.

    answer : once it is over; failure : its error instead
    """

    def __init__(self, verb: Callable[[], Any]) -> None:
        self._verb = verb
        self.answer: Any = None
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="driver", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether it has returned or failed."""
        return not self._thread.is_alive()

    def await_end(self, timeout_s: float) -> None:
        """Wait for its end, at most `timeout_s`."""
        host_clock.join(self._thread, timeout_s)

    def _run(self) -> None:
        try:
            self.answer = self._verb()
        except BaseException as error:
            self.failure = error


def guard(
    device: D, point: EntryPoint, limits_s: Mapping[str, float] | None = None
) -> D:
    """A device behind the border; `isinstance` still works on it.

    limits_s : by call, in place of the default limit, beyond its requested time
    """
    return cast(D, _Border(device, point, limits_s or {}))


def find_stuck(*devices: object) -> str:
    """First overdue call of guarded devices, as text; empty without one."""
    borders = (one for one in devices if type(one) is _Border)
    return next((call for one in borders for call in one.list_stuck()), "")


def list_origins(**devices: object) -> dict[str, PluginOrigin]:
    """Plug-ins of guarded devices, by the names given to them."""
    borders = ((word, one) for word, one in devices.items() if type(one) is _Border)
    return {word: one.origin for word, one in borders}


class _Border:
    def __init__(
        self, device: Device, point: EntryPoint, limits_s: Mapping[str, float]
    ) -> None:
        self._device, self._who = device, describe_plugin(point)
        self.origin = find_origin(point, device)
        self._limits_s = _LIMITS_S | dict(limits_s)
        self._overdue: dict[str, Call] = {}
        self._known: dict[str, Any] = {}  # of properties, the newest

    @property
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return type(self._device)

    __enter__, __exit__ = Device.__enter__, Device.__exit__

    def __getattr__(self, name: str) -> Any:
        if name in _PROPERTIES:
            return self._call(name, lambda: getattr(self._device, name))
        value = getattr(self._device, name)
        if name.startswith("_") or not callable(value):
            return value
        return lambda *given, **named: self._call(
            name, lambda: value(*given, **named), *given, *named.values()
        )

    def list_stuck(self) -> list[str]:
        overdue = self._overdue.copy().items()
        return [name for name, call in overdue if not call.is_over]

    def _call(self, name: str, verb: Callable[[], Any], *given: Any) -> Any:
        stuck = self.list_stuck()
        if stuck and name in self._known:
            return self._known[name]
        if stuck and (name not in _STOPS or name in stuck):
            raise self._fault(f"still has not returned from {stuck[0]}()")
        left_s = limit_s = self._find_limit_s(name, given)
        call = Call(lambda: self._check(name, verb()))
        while not call.is_over:
            if left_s <= 0.0:
                self._overdue[name] = call
                raise self._fault(f"has not returned from {name}() in {limit_s:g} s")
            begin_s = host_clock.now_s()
            call.await_end(min(left_s, _SLICE_S))
            # A process that did not run has not let the driver run either.
            left_s -= min(host_clock.now_s() - begin_s, 2.0 * _SLICE_S)
        if call.failure is not None:
            raise self._translate(call.failure, name) from call.failure
        if name in _PROPERTIES:
            self._known[name] = call.answer
        return call.answer

    def _find_limit_s(self, name: str, given: tuple[Any, ...]) -> float:
        if name == "load":
            return _LOAD_S + _LOAD_ROW_S * len(given[0])
        if name in _TURNS and not isinstance(self._device, MotionController):
            return 0.5 + self.__getattr__("verb_limit_s")
        if name == "measure":
            return given[0] + self._limits_s.get(name, _POINT_S)
        asked_s = given[0] if given and name in ("read", "wait", "home") else 0.0
        return asked_s + self._limits_s.get(name, QUICK_S)

    def _fault(self, text: str) -> DriverFault:
        return DriverFault(f"{self._who} {text}; {REMEDY}")

    def _translate(self, error: BaseException, name: str) -> DeviceError:
        if not isinstance(error, DeviceError):
            return self._fault(f"has failed in {name}() ({word_error(error)})")
        if vars(errors).get(type(error).__name__) is type(error) and str(error):
            return error
        # Other processes do not know a class of the driver's own.
        family = next(c for c in type(error).__mro__ if c.__module__ == errors.__name__)
        return family(f"{self._who}: {word_error(error)}")

    def _check(self, name: str, answer: Any) -> Any:
        try:
            return self._convert(name, answer)
        except (AttributeError, TypeError, ValueError) as error:
            text = f"has answered {name}() with nonsense: {_shorten(error)}"
            raise self._fault(text) from error

    def _convert(self, name: str, answer: Any) -> Any:
        device: Any = self._device
        if name == "read" and isinstance(device, Thermometers):
            readings = tuple(_rebuild(Reading, one) for one in answer)
            known = [channel.name for channel in device.channels]
            if odd := [r.channel for r in readings if r.channel not in known]:
                raise ValueError(f"a reading of {odd[0]!r}, which is no channel")
            return readings
        if name in ("read", "measure"):
            kind = TrackerSamples if name == "read" else PointMeasurement
            return _check_arrays(answer, kind)
        checked: Any = _rebuild(_KINDS[name], answer) if name in _KINDS else answer
        if isinstance(checked, MotionStatus):
            axes, count = device.axes, len(checked.position)
            if count != len(axes):
                raise ValueError(f"{count} positions of {len(axes)} axes")
        return checked


@cache
def _adapt(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _rebuild(kind: Any, value: Any) -> Any:
    """A record of a subclass becomes one of exactly this class."""
    parts = _take_apart(kind, value) if is_dataclass(kind) else value
    return _adapt(kind).validate_python(parts)


def _take_apart(kind: Any, value: Any) -> dict[str, Any]:
    if not isinstance(value, kind):
        raise TypeError(f"{type(value).__name__} in place of {kind.__name__}")
    return {f.name: getattr(value, f.name) for f in fields(kind)}


def _check_arrays(value: Any, kind: type) -> Any:
    parts = _take_apart(kind, value)
    each = (len(parts["sequence"]),) if kind is TrackerSamples else ()
    for name, shape in _SHAPES[kind].items():
        part = parts[name]
        if part is None and name == "quality":
            continue
        if not isinstance(part, np.ndarray) or part.dtype.kind not in "fiu":
            raise TypeError(f"{name} is no array of numbers")
        if part.shape != each + shape:
            raise ValueError(f"{name} has the shape {part.shape}, not {each + shape}")
    if kind is PointMeasurement:
        numbers = {"time_s": float, "quality": float, "count": int}
        parts |= {name: _rebuild(one, parts[name]) for name, one in numbers.items()}
    return kind(**parts)


def _shorten(error: Exception) -> str:
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"]))
    return f"{place} is {first['input']!r}: {first['msg'].lower()}"
