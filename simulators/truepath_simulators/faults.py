"""Faults and their times, one line of text each.

    device:kind[@begin][+duration][*amount]

    tracker:silence@12s+0.5s        half a second of silence, 12 s after the first START
    tracker:bit-flip@5s+10s*0.01    one frame in a hundred damaged for ten seconds
    tracker:spike@800n*0.3          sample 800 is off by 0.3 mm
    cnc:alarm@row5                  alarm on the way to row 5
    tracker:target@row12*4          from row 12 on the fourth target is looked at
    thermometers:stuck@60s*1        the first sensor shows the same from then on

`begin` counts device seconds (`s`) since the last START before the machine first moved
(tracker) or the first motion (others), samples (`n`) or rows (`row5`); in a fault
injected into a running simulator it counts from then. Without `begin` a fault is there
from the first moment on; one that strikes single frames strikes the first.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from truepath_simulators.errors import SimulatorError


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of fault.

    amount : default of the amount, where it has one
    lasts : without a duration it continues for ever; others strike once
    """

    meaning: str
    amount: float = 0.0
    lasts: bool = True


TRACKER_KINDS = {
    "silence": Kind("nothing is sent"),
    "delay": Kind("frames are kept back and come late"),
    "drop": Kind("share of frames that are not sent", 1.0, lasts=False),
    "lost-bytes": Kind("share of frames that lose a byte", 1.0, lasts=False),
    "bit-flip": Kind("share of frames with a flipped bit", 1.0, lasts=False),
    "duplicate": Kind("share of frames that come twice", 1.0, lasts=False),
    "noise": Kind("bytes of noise before a frame", 400.0, lasts=False),
    "beam-break": Kind("samples are not valid"),
    "beam-lost": Kind("the beam is lost until it is told to search", lasts=False),
    "unhomed": Kind("it refuses to measure until it is homed"),
    "frozen": Kind("valid samples show the last place, to the last bit"),
    "spike": Kind("valid samples that are off by so many mm", 0.5, lasts=False),
    "knock": Kind("its stand is pushed aside by so many mm", 0.02),
    "disconnect": Kind("the link closes and comes back", lasts=False),
    "wrong-identity": Kind("another device answers"),
    "target": Kind("it turns to the machine's target of this number", 1.0),
}
CNC_KINDS = {
    "alarm": Kind("alarm with this code; its cause stays", 1001.0, lasts=False),
    "estop": Kind("the emergency stop is pressed; its button stays", lasts=False),
    "door": Kind("a door is open"),
    "drives-off": Kind("the drives are switched off", lasts=False),
    "unhomed": Kind("it has lost where its axes are", lasts=False),
    "unreferenced": Kind("it can be driven without knowing its axes", lasts=False),
    "feed-hold": Kind("the operator holds the feed, then lets it go"),
    "override": Kind("the operator turns the feed to this factor", 0.5),
    "shifted": Kind("positions read so many mm off", 6.5536),
    "zeroed": Kind("positions read zero"),
    "silence": Kind("requests are not answered"),
    "exception": Kind("requests are answered by this exception code", 4.0),
    "ignore-writes": Kind("writes are answered and forgotten"),
    "ignore-commands": Kind("all writes but beats of the watchdog are forgotten"),
    "disconnect": Kind("TCP connections close", lasts=False),
    "wrong-identity": Kind("another device answers"),
}
THERMOMETER_KINDS = {  # amount: number of the sensor, from 1; 0 is all
    "silence": Kind("requests for it are not answered"),
    "stuck": Kind("it shows what it showed at the begin"),
    "broken-wire": Kind("it shows its highest number, or none"),
    "exception": Kind("requests are answered by this exception code", 4.0),
    "disconnect": Kind("TCP connections close", lasts=False),
}
KINDS = {
    "tracker": TRACKER_KINDS,
    "cnc": CNC_KINDS,
    "thermometers": THERMOMETER_KINDS,
}

_NUMBER = r"\d+(?:\.\d*)?|\.\d+"
_FORM = re.compile(
    rf"(?P<device>[a-z]+):(?P<kind>[a-z-]+)"
    rf"(?:@(?:(?P<begin>{_NUMBER})(?P<unit>s|n)|row(?P<row>\d+)))?"
    rf"(?:\+(?P<duration>{_NUMBER})s)?"
    rf"(?:\*(?P<amount>{_NUMBER}))?"
)


@dataclass(frozen=True, slots=True)
class Fault:
    """A kind of fault with its time and amount.

    begin : None is from the first moment on; unit : `s`, `n` (samples) or `row`
    """

    device: str
    kind: str
    begin: float | None = None
    unit: str = "s"
    duration_s: float | None = None
    amount: float = 0.0

    @property
    def lasts(self) -> bool:
        """Whether it continues from moment to moment, rather than strikes once."""
        return self.duration_s is not None or KINDS[self.device][self.kind].lasts


def parse_fault(text: str) -> Fault:
    """Raises SimulatorError naming the part that is not understood."""
    found = _FORM.fullmatch(text.strip())
    if not found:
        raise SimulatorError(
            f"fault {text!r}: expected device:kind[@begin][+duration][*amount], "
            "such as tracker:silence@12s+0.5s"
        )
    device, kind, row = found["device"], found["kind"], found["row"]
    if kind not in KINDS.get(device, {}):
        known = ", ".join(f"{d}:{k}" for d, kinds in KINDS.items() for k in kinds)
        raise SimulatorError(f"fault {text!r}: unknown; known are {known}")
    begin = row or found["begin"]
    return Fault(
        device,
        kind,
        None if begin is None else float(begin),
        "row" if row else found["unit"] or "s",
        None if found["duration"] is None else float(found["duration"]),
        float(found["amount"] or KINDS[device][kind].amount),
    )


@dataclass(slots=True)
class _Armed:
    fault: Fault
    reference_s: float | None = None
    began_s: float | None = None
    spent: bool = False
    is_injected: bool = False


class Schedule:
    """Faults that wait for their time. Times are seconds of the machine's clock."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._armed = [_Armed(fault) for fault in faults]

    def begin(self, now_s: float) -> None:
        """Start the time of faults now; later calls change nothing."""
        for armed in self._armed:
            if armed.reference_s is None:
                armed.reference_s = now_s

    def start_over(self) -> None:
        """Start again at the next `begin`, for faults that have not struck yet."""
        for armed in self._armed:
            if not (armed.is_injected or armed.spent or armed.began_s is not None):
                armed.reference_s = None

    def add(self, fault: Fault, now_s: float) -> None:
        """Add a fault whose time starts now."""
        self._armed.append(_Armed(fault, now_s, is_injected=True))

    def has(self, kind: str) -> bool:
        """Whether a fault of this kind is pending or in progress."""
        return any(a.fault.kind == kind and not a.spent for a in self._armed)

    def struck(
        self, kind: str, time_s: np.ndarray, count: np.ndarray
    ) -> Iterator[tuple[Fault, np.ndarray]]:
        """Faults, each with a mask of the moments (n,) that it strikes.

        time_s : (n,) rising from call to call
        count : (n,) number of samples, or row, at each moment
        """
        for armed in self._armed:
            if armed.fault.kind == kind and not armed.spent:
                mask = _mask(armed, time_s, count)
                if mask.any():
                    yield armed.fault, mask

    def strikes(self, kind: str, now_s: float, count: float = 0.0) -> Fault | None:
        """A fault of the kind that strikes now, if any."""
        for fault, _ in self.struck(kind, np.array([now_s]), np.array([count])):
            return fault
        return None


def _mask(armed: _Armed, time_s: np.ndarray, count: np.ndarray) -> np.ndarray:
    begun = _has_begun(armed, time_s, count)
    if not begun.any():
        return begun
    if not armed.fault.lasts:
        armed.spent = True
        return begun & (np.cumsum(begun) == 1)
    if armed.began_s is None:
        armed.began_s = float(time_s[np.argmax(begun)])
    if armed.fault.duration_s is None:
        return begun
    return begun & (time_s < armed.began_s + armed.fault.duration_s)


def _has_begun(armed: _Armed, time_s: np.ndarray, count: np.ndarray) -> np.ndarray:
    fault = armed.fault
    if armed.began_s is not None:
        return time_s >= armed.began_s
    if armed.reference_s is None:
        at_once = fault.begin is None and fault.lasts
        return np.full(len(time_s), at_once)
    if fault.begin is None or fault.unit == "s":
        return time_s >= armed.reference_s + (fault.begin or 0.0)
    return count >= fault.begin
