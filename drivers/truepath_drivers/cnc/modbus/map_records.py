"""The register map's contents as records: values, identity, status, paths."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.cnc.modbus import registers as r
from truepath_drivers.cnc.modbus.registers import (
    BY_NAME,
    DWELL_COUNTS,
    FEED_COUNTS,
    MAX_AXES,
    POSITION_COUNTS,
    Block,
    Kind,
)
from truepath_drivers.interfaces.errors import WrongDevice
from truepath_drivers.interfaces.records import (
    UNABLE,
    Identity,
    MotionState,
    MotionStatus,
    Path,
)


def encode(name: str, value: int | str | Sequence[int]) -> list[int]:
    """Words of a register's value: a number, one per count, or a text."""
    register = BY_NAME[name]
    if isinstance(value, str):
        size = 2 * register.count
        data = value.encode("ascii", "replace")[:size].ljust(size, b"\0")
        return list(struct.unpack(f">{register.count}H", data))
    values = [value] if isinstance(value, int) else list(value)
    values += [0] * (register.count - len(values))
    if register.kind is Kind.U16:
        return [v & 0xFFFF for v in values]
    return [word for v in values for word in (v >> 16 & 0xFFFF, v & 0xFFFF)]


def decode(name: str, words: Sequence[int], block: Block) -> tuple[int, ...]:
    """Values of a register from the words of the block that holds it."""
    register = BY_NAME[name]
    at = register.address - block.address
    own = words[at : at + register.words]
    if register.kind is Kind.U16:
        return tuple(own)
    wide = [own[i] << 16 | own[i + 1] for i in range(0, len(own), 2)]
    if register.kind is Kind.I32:
        return tuple(v - (1 << 32) if v >> 31 else v for v in wide)
    return tuple(wide)


def decode_text(name: str, words: Sequence[int], block: Block) -> str:
    """Text of a register from the words of the block that holds it."""
    register = BY_NAME[name]
    at = register.address - block.address
    own = b"".join(word.to_bytes(2, "big") for word in words[at : at + register.count])
    return own.split(b"\0")[0].decode("ascii", "replace").strip()


def position_counts(position: Sequence[float]) -> list[int]:
    """Positions in mm or deg as counts of the map."""
    return [round(p * POSITION_COUNTS) for p in position]


_HOLD_REASONS = {reason.value: reason.name.lower() for reason in r.HoldReason}
_HOLD_REASONS[r.HoldReason.NONE] = ""
_SWAPPED = {  # as `ORDER_TEST`, 0x01020304, comes
    0x03040102: "low word first; set it to high word first",
    0x02010403: "low byte first; set it to high byte first",
    0x04030201: "words and bytes swapped; set it to big-endian",
}


@dataclass(frozen=True, slots=True)
class Controller:
    """Identity and features of a controller: read once, at `connect`.

    features : bits of the register of that name
    """

    identity: Identity
    axes: tuple[str, ...]
    travel: tuple[tuple[float, float], ...]
    max_feed_mm_min: float
    max_waypoints: int
    features: int = 0

    @property
    def status_block(self) -> r.Block:
        """The polled block: the status, and the readiness where it is offered."""
        if self.features & (r.TELLS_REFERENCED | r.TELLS_COMPENSATION):
            return r.Block(r.STATUS.address, r.STATUS.count + r.READINESS.count)
        return r.STATUS


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """One reading of the status block; an alarm is a code here, not yet a text."""

    motion: MotionStatus
    acknowledged: int
    result: int
    path_rows: int
    path_crc: int


def parse_controller(words: Sequence[int]) -> Controller:
    """Identity block as a record. Raises WrongDevice if it is none."""
    problem = explain_magic(words)
    if problem:
        raise WrongDevice(problem)

    def numbers(name: str) -> tuple[int, ...]:
        return decode(name, words, r.IDENTITY)

    def text(name: str) -> str:
        return decode_text(name, words, r.IDENTITY)

    count = numbers("axis_count")[0]
    if not 1 <= count <= r.MAX_AXES:
        raise WrongDevice(f"the device says it has {count} axes; 1 to 6 are possible")
    limits = zip(numbers("travel_min"), numbers("travel_max"), strict=True)
    travel = tuple(
        (low / r.POSITION_COUNTS, high / r.POSITION_COUNTS) for low, high in limits
    )
    drives_arcs = bool(numbers("features")[0] & r.DRIVES_ARCS)
    return Controller(
        Identity(
            text("maker"),
            text("model"),
            text("serial_number"),
            text("firmware"),
            drives_arcs=drives_arcs,
        ),
        tuple(chr(code) for code in numbers("axis_names")[:count]),
        travel[:count],
        numbers("max_feed")[0] / r.FEED_COUNTS,
        numbers("max_waypoints")[0],
        numbers("features")[0],
    )


def explain_magic(words: Sequence[int]) -> str:
    """Error in magic, word or byte order, or version; "" if there is none."""
    (magic,) = decode("magic", words, r.IDENTITY)
    (order,) = decode("order_test", words, r.IDENTITY)
    (version,) = decode("map_version", words, r.IDENTITY)
    if order in _SWAPPED:
        return f"the device or a gateway sends 32-bit values with {_SWAPPED[order]}"
    if (magic, order) != (r.MAGIC, r.ORDER_TEST):
        return (
            f"registers 0–3 hold {magic:08x} {order:08x}, not {r.MAGIC:08x} "
            f"{r.ORDER_TEST:08x}: this is not the register map; check address and unit"
        )
    if version != r.MAP_VERSION:
        return (
            f"the device has register map {version}, this driver knows "
            f"{r.MAP_VERSION}; update the older one"
        )
    return ""


def parse_status(words: Sequence[int], *, features: int = 0) -> ControllerStatus:
    """Status block as a record, with positions of all six axes."""

    def number(name: str) -> int:
        return decode(name, words, r.STATUS)[0]

    state, reason, alarm = number("state"), number("hold_reason"), number("alarm_code")
    if state >= len(r.STATES):
        raise WrongDevice(f"the device reports state {state}, which the map lacks")
    positions = decode("position", words, r.STATUS)
    override = number("override") / r.OVERRIDE_COUNTS
    motion = MotionStatus(
        r.STATES[state],
        tuple(count / r.POSITION_COUNTS for count in positions),
        number("line"),
        _explain(r.STATES[state], alarm),
        _HOLD_REASONS.get(reason, f"reason {reason}"),
        override if override > 0.0 or features & r.TELLS_OVERRIDE else None,
        *_read_readiness(words, features),
    )
    return ControllerStatus(
        motion,
        number("command_ack"),
        number("command_result"),
        number("path_rows"),
        number("path_crc"),
    )


def _read_readiness(
    words: Sequence[int], features: int
) -> tuple[bool | None, bool | None]:
    """Whether it is referenced and compensates, None for what it does not offer."""
    if len(words) <= r.STATUS.count:
        return None, None
    (bits,) = decode("readiness", words, r.STATUS)
    referenced, compensates = bits & r.IS_REFERENCED, bits & r.IS_COMPENSATING
    return (
        bool(referenced) if features & r.TELLS_REFERENCED else None,
        bool(compensates) if features & r.TELLS_COMPENSATION else None,
    )


def _explain(state: MotionState, alarm: int) -> str:
    if state is MotionState.ALARM:
        return f"alarm {alarm}"
    return str(UNABLE[state]) if state in UNABLE else ""


def path_words(path: Path) -> NDArray[np.uint16]:
    """Rows of a path in the map's format, (n, 16)."""
    rows = np.zeros((len(path), MAX_AXES + 2), ">i4")
    axes = path.position.shape[1]
    rows[:, :axes] = np.rint(path.position * POSITION_COUNTS)
    # Feed and dwell are u32; neither can reach the sign bit within its limits.
    rows[:, MAX_AXES] = np.rint(path.feed_mm_min * FEED_COUNTS)
    rows[:, MAX_AXES + 1] = np.rint(path.dwell_s * DWELL_COUNTS)
    return rows.view(">u2").astype(np.uint16)


def arc_words(path: Path) -> dict[int, NDArray[np.uint16]]:
    """Arcs of a path in the map's format, (16,) each, by row.

    The centre takes the place of a position, 0 for other axes, the turn in 0.0001 deg
    that of the feed, and the numbers of both axes that of the dwell.
    """
    found: dict[int, NDArray[np.uint16]] = {}
    for row, arc in enumerate(path.arc):
        if arc is None:
            continue
        first, second = (path.axes.index(name) for name in arc.axes)
        values = np.zeros(MAX_AXES + 2, ">i4")
        values[[first, second]] = np.rint(np.array(arc.centre_mm) * POSITION_COUNTS)
        values[MAX_AXES] = round(arc.turn_deg * POSITION_COUNTS)
        values[MAX_AXES + 1] = first << 16 | second
        found[row] = values.view(">u2").astype(np.uint16)
    return found


def path_crc(
    words: NDArray[np.uint16], arcs: Mapping[int, NDArray[np.uint16]] | None = None
) -> int:
    """CRC-32 (zlib's) of rows, over their bytes in wire order.

    arcs : by row; each follows, its row first, in their order
    """
    crc = zlib.crc32(words.astype(">u2").tobytes())
    for row, arc in sorted((arcs or {}).items()):
        crc = zlib.crc32(np.append(row, arc).astype(">u2").tobytes(), crc)
    return crc
