"""`error_tables.csv`: every value of the error tables on a row of its own."""

from __future__ import annotations

from collections.abc import Iterator

from app.reporting.error_tables import ErrorTables

HEADER = "error,position_mm,value,uncertainty,unit"


def error_tables_csv(tables: ErrorTables) -> str:
    """Return the text of the file; uncertainties are standard ones (k = 1).

    A squareness belongs to no position: its cell is empty.
    """
    return "".join(f"{line}\n" for line in _lines(tables))


def _lines(tables: ErrorTables) -> Iterator[str]:
    yield HEADER
    for table in tables.tables:
        rows = zip(table.position_mm, table.value, table.uncertainty, strict=True)
        for position_mm, value, uncertainty in rows:
            yield (
                f"{table.symbol},{position_mm:.4f},{value:z.5f},{uncertainty:.5f},"
                f"{table.unit}"
            )
    for square in tables.squareness:
        yield (
            f"{square.symbol},,{square.value_urad:z.5f},{square.uncertainty_urad:.5f},"
            "urad"
        )
