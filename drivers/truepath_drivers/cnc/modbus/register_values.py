"""Values of the register map as words, and back."""

from __future__ import annotations

from collections.abc import Sequence

from truepath_drivers.cnc.modbus.registers import BY_NAME, POSITION_COUNTS, Block, Kind


def encode(name: str, value: int | str | Sequence[int]) -> list[int]:
    """Words of a register's value: a number, one per count, or a text."""
    register = BY_NAME[name]
    if isinstance(value, str):
        data = value.encode("ascii", "replace")[: 2 * register.count]
        padded = data.ljust(2 * register.count, b"\0")
        return [
            int.from_bytes(padded[i : i + 2], "big") for i in range(0, len(padded), 2)
        ]
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
