"""`error_tables.csv`: every value of the error tables on a row of its own."""

from __future__ import annotations

from collections.abc import Iterator

from app.results.error_tables import ErrorTables

HEADER = "error,position_mm,value,uncertainty,unit,extrapolated"


def error_tables_csv(tables: ErrorTables) -> str:
    """Return the text of the file; uncertainties are standard ones (k = 1).

    A squareness belongs to no position: its cell is empty. `extrapolated` is 1 beyond
    the measured range of the axis. A machine with rotary axes has a further column,
    `position_deg`.
    """
    turns = any(table.position_unit == "deg" for table in tables.tables)
    lines = _lines(tables) if not turns else _turning_lines(tables)
    return "".join(f"{line}\n" for line in lines)


def _turning_lines(tables: ErrorTables) -> Iterator[str]:
    deg = {t.symbol for t in tables.tables if t.position_unit == "deg"}
    for line in _lines(tables):
        symbol, position, *rest = line.split(",")
        if line == HEADER:
            yield f"{line},position_deg"
        elif symbol in deg:
            yield ",".join([symbol, "", *rest, position])
        else:
            yield f"{line},"
    for place in tables.locations:
        yield (
            f"{place.symbol},,{place.value:z.5f},{place.uncertainty:.5f},{place.unit},,"
        )


def _lines(tables: ErrorTables) -> Iterator[str]:
    yield HEADER
    for table in tables.tables:
        rows = zip(
            table.position_mm,
            table.value,
            table.uncertainty,
            table.extrapolated,
            strict=True,
        )
        for position_mm, value, uncertainty, beyond in rows:
            yield (
                f"{table.symbol},{position_mm:.4f},{value:z.5f},{uncertainty:.5f},"
                f"{table.unit},{int(beyond)}"
            )
    for square in tables.squareness:
        yield (f"{square.symbol},,{square.value:z.5f},{square.uncertainty:.5f},urad,")
