"""The blocks of a measuring program in the order that every control shares."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from app.motion.nc_programs.program_content import ProgramContent, ProgramRow

CHECK_WAY = "ROW 1 IS APPROACHED STRAIGHT. WAY FREE - CYCLE START"
START_RECORDING = "START THE RECORDING. AFTER 2 S CYCLE START"
STOP_RECORDING = "END. AFTER 2 S STOP THE RECORDING"


def arrange_blocks(
    rows: Iterable[ProgramRow],
    *,
    write_stop: Callable[[str], Iterable[str]],
    write_motion: Callable[[ProgramRow], Iterable[str]],
    write_dwell: Callable[[float], Iterable[str]],
) -> Iterator[str]:
    """Yield the blocks of all rows, with the stops at which the operator acts.

    write_stop : the blocks of a program stop with its message
    write_dwell : the blocks of a dwell in s, which may be 0
    """
    yield from write_stop(CHECK_WAY)
    for row in rows:
        if row.target_change:
            yield from write_stop(row.target_change)
        yield from write_motion(row)
        if row.number == 1:
            yield from write_stop(START_RECORDING)
        yield from write_dwell(row.dwell_s)


def format_position(content: ProgramContent, row: ProgramRow, form: str) -> str:
    """Return the axis words of a row; `form` is the format of a number."""
    words = zip(content.axes, row.position, strict=True)
    return " ".join(f"{axis}{value:{form}}" for axis, value in words)
