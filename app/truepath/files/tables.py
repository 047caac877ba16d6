"""Tables of numbers at the border, CSV or Parquet, with the place of an error.

Rows in error texts are counted as a text editor shows them: the header of a CSV file is
row 1, its first data row is row 2 (blank lines count). A Parquet file has no header:
its first row is row 1.
"""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from truepath.errors import BundleError

MAX_ROWS = 50_000_000
MAX_COLUMNS = 500
MAX_LINE_BYTES = 1 << 16
MAX_NUMBER_BYTES = 40  # of one that is written as text
SMALL_BYTES = 64 << 20  # a table of numbers that may be packed however well
_AS_CSV = "save it as CSV in UTF-8, its lines ended by line feeds"
UNPACKED_SHARE = 50
"""How many times the size of its file a larger one may have. Measured: 1 to 3."""


@dataclass(frozen=True, slots=True)
class Table:
    """Named columns of one file; `row_of` gives the row of a data index in the file."""

    file: str
    data: pa.Table
    row_of: Callable[[int], int]

    def __len__(self) -> int:
        return self.data.num_rows

    @property
    def names(self) -> tuple[str, ...]:
        """In the order of the file."""
        return tuple(self.data.column_names)

    def require(self, *names: str) -> None:
        """Raise BundleError naming the first of these columns that is missing."""
        for name in names:
            if name not in self.names:
                found = ", ".join(self.names)
                raise BundleError(
                    "is missing",
                    file=self.file,
                    column=name,
                    remedy=f"the file has {found[:80]}",
                )

    def error(
        self, problem: str, index: int, column: str | None, remedy: str = ""
    ) -> BundleError:
        """Counts the data row from 0; the error names the row of the file."""
        row = self.row_of(index)
        return BundleError(
            problem, file=self.file, row=row, column=column, remedy=remedy
        )

    def reject(
        self,
        bad: NDArray[np.bool_],
        column: str,
        describe: Callable[[int], str],
        remedy: str = "",
    ) -> None:
        """Raise the error of the first bad row, if there is one."""
        if bad.any():
            index = int(np.argmax(bad))
            raise self.error(describe(index), index, column, remedy)

    def require_rows(self, remedy: str) -> None:
        """Raise BundleError if there is no row."""
        if not len(self):
            raise BundleError("has no rows", file=self.file, remedy=remedy)

    def numbers(
        self, name: str, *, nan: bool = False, infinite: bool = False
    ) -> NDArray[np.float64]:
        """As float64; empty cells are NaN, refused unless `nan`. Raises BundleError."""
        self.require(name)
        value = _convert_column(self, name)
        if not infinite:
            self.reject(np.isinf(value), name, lambda _: "is infinite")
        if not nan:
            empty, remedy = np.isnan(value), "every row needs a number"
            self.reject(empty, name, lambda _: "is empty or NaN", remedy)
        return value

    def find_empty(self, name: str) -> NDArray[np.bool_]:
        """Cells of a column without content, not even NaN."""
        return np.array(self.data[name].is_null())

    def cells(self, name: str) -> list[str]:
        """As in the file, empty cells as empty texts. Raises BundleError."""
        self.require(name)
        column = self.data[name].cast(pa.string()).to_pylist()
        return [cell or "" for cell in column]

    def texts(self, name: str) -> list[str]:
        """Stripped words; raises BundleError for an empty one."""
        words = [cell.strip() for cell in self.cells(name)]
        if "" in words:
            raise self.error("is empty", words.index(""), name)
        return words

    def choices(self, name: str, known: Collection[str], remedy: str) -> list[str]:
        """Stripped words; raises BundleError for an unknown one."""
        words = self.texts(name)
        for index, word in enumerate(words):
            if word not in known:
                raise self.error(f"is {word!r}, unknown", index, name, remedy)
        return words


def encode_csv(columns: Mapping[str, Iterable[object]]) -> bytes:
    """Comma-separated values with a header; numbers keep all their digits."""
    cells = [
        map(repr, np.asarray(column, np.float64).tolist())
        if isinstance(column, np.ndarray)
        else map(str, column)
        for column in columns.values()
    ]
    lines = [columns, *zip(*cells, strict=True)]
    return "".join(f"{','.join(line)}\n" for line in lines).encode()


def read_csv(data: bytes, file: str) -> Table:
    """Read comma-separated values with a header.

    Raises BundleError, also if lines, columns or rows are beyond the limits above.
    """
    _reject_odd_lines(data, file)
    names = _read_header(data, file)
    if (rows := data.count(b"\n")) > MAX_ROWS:
        raise BundleError(f"has {rows} rows, more than {MAX_ROWS}", file=file)
    broken: list[pacsv.InvalidRow] = []

    def keep(row: pacsv.InvalidRow) -> str:
        broken.append(row)
        return "error"

    try:
        table = pacsv.read_csv(
            pa.BufferReader(data),
            read_options=pacsv.ReadOptions(
                use_threads=False, column_names=names, skip_rows=1
            ),
            parse_options=pacsv.ParseOptions(invalid_row_handler=keep),
            convert_options=pacsv.ConvertOptions(
                column_types={name: pa.string() for name in names},
                strings_can_be_null=True,
                null_values=_EMPTY,
            ),
        )
    except pa.ArrowInvalid as error:
        if not broken:
            raise BundleError(
                f"cannot be read as CSV ({error})", file=file, remedy="save it as UTF-8"
            ) from error
        row = broken[0]
        raise BundleError(
            f"has {row.actual_columns} cells, the header {row.expected_columns}",
            file=file,
            row=_find_line(data, row.number - 2),
            remedy="columns are separated by commas",
        ) from error
    return Table(file, table, lambda index: _find_line(data, index))


_EMPTY = [  # NaN is a value: of a beam that was lost
    text
    for text in pacsv.ConvertOptions().null_values
    if text.lower().lstrip("-") != "nan"
]


def read_parquet(data: bytes, file: str, known: Collection[str]) -> Table:
    """Read the known columns only. Raises BundleError."""
    try:
        source = _open_parquet(data)
        fields = [field for field in source.schema_arrow if field.name in known]
        names = [field.name for field in fields]
        _reject_repeated(names, file)
        _reject_large(source.metadata.num_rows, len(names), len(data), file)
        texts = [field.name for field in fields if _holds_texts(field, file)]
        table = _open_parquet(data, texts).read(names, use_threads=False)
    except MemoryError:  # one of Arrow's own exceptions as well
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise BundleError(
            "is truncated or not a Parquet file", file=file, remedy="copy it again"
        ) from error
    for name in texts:
        column = _unpack_texts(table[name], file, name)
        table = table.set_column(names.index(name), name, column)
    return Table(file, table, lambda index: index + 1)


def _open_parquet(data: bytes, texts: Sequence[str] = ()) -> pq.ParquetFile:
    return pq.ParquetFile(
        pa.BufferReader(data),
        read_dictionary=list(texts),
        page_checksum_verification=True,
    )


def _holds_texts(field: pa.Field, file: str) -> bool:
    kind = field.type
    if pa.types.is_string(kind):
        return True
    if not (pa.types.is_primitive(kind) or pa.types.is_null(kind)):
        problem = f"holds {kind}, not numbers"[:80]
        raise BundleError(problem, file=file, column=field.name)
    return False


def _unpack_texts(column: pa.ChunkedArray, file: str, name: str) -> pa.ChunkedArray:
    """Dictionary-encoded texts to plain ones. Raises BundleError if they are long."""
    import pyarrow.compute as pc  # slow to import, and no reader of a table needs it

    size = 0
    for part in column.chunks:
        lengths = pc.call_function("binary_length", [part.dictionary])
        size += pc.call_function("sum", [lengths.take(part.indices)]).as_py() or 0
    if size > max(SMALL_BYTES, MAX_NUMBER_BYTES * len(column)):
        raise BundleError("holds long texts, not numbers", file=file, column=name)
    return column.cast(pa.string())


def _reject_large(rows: int, columns: int, packed_bytes: int, file: str) -> None:
    if rows > MAX_ROWS:
        raise BundleError(f"has {rows} rows, more than {MAX_ROWS}", file=file)
    if 8 * rows * columns > max(SMALL_BYTES, UNPACKED_SHARE * packed_bytes):
        raise BundleError(
            f"has {rows} rows in {packed_bytes} bytes; nothing measured packs so well",
            file=file,
            remedy="record the stream again",
        )


def _reject_odd_lines(data: bytes, file: str) -> None:
    row = 1
    for begin, end in _split_at_lines(data, MAX_LINE_BYTES):
        if end - begin > MAX_LINE_BYTES:
            problem = f"is longer than {MAX_LINE_BYTES >> 10} KiB"
            remedy = "end every row with a line break"
            raise BundleError(problem, file=file, row=row, remedy=remedy)
        try:
            data[begin:end].decode()
        except UnicodeDecodeError as error:
            row += data.count(b"\n", begin, begin + error.start)
            raise BundleError(
                "is not text in UTF-8", file=file, row=row, remedy="save it as UTF-8"
            ) from error
        row += data.count(b"\n", begin, end)


def _split_at_lines(data: bytes, size: int) -> Iterator[tuple[int, int]]:
    begin = 0
    while begin < len(data):
        end = len(data)
        if end - begin > size:
            end = data.rfind(b"\n", begin, begin + size) + 1
            end = end or data.find(b"\n", begin + size) + 1 or len(data)
        yield begin, end
        begin = end


def _read_header(data: bytes, file: str) -> list[str]:
    line = data.partition(b"\n")[0]
    text = line.decode("utf-8-sig").rstrip("\r")
    try:
        names = [name.strip() for name in next(csv.reader(io.StringIO(text)), [])]
    except csv.Error as error:
        raise BundleError(
            f"cannot be read as CSV ({error})", file=file, row=1, remedy=_AS_CSV
        ) from error
    if len(names) > MAX_COLUMNS:
        problem = f"has {len(names)} columns, more than {MAX_COLUMNS}"
        raise BundleError(problem, file=file, row=1, remedy="leave out the others")
    if not any(names):
        raise BundleError("has no header", file=file, row=1, remedy="name the columns")
    _reject_repeated(names, file)
    return names


def _reject_repeated(names: list[str], file: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise BundleError("appears more than once", file=file, column=name)


def _find_line(data: bytes, index: int) -> int:
    """Skips blank lines, as the reader does."""
    seen = -1
    lines = (line for part in io.BytesIO(data) for line in part.splitlines())
    for number, line in enumerate(itertools.islice(lines, 1, None), start=2):
        seen += bool(line)
        if seen == index:
            return number
    return index + 2


def _convert_column(table: Table, name: str) -> NDArray[np.float64]:
    column = table.data[name]
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        column = _parse_column(table, name, column)
    elif not (
        pa.types.is_integer(column.type)
        or pa.types.is_floating(column.type)
        or pa.types.is_null(column.type)
    ):
        raise BundleError(
            f"holds {column.type}, not numbers", file=table.file, column=name
        )
    value = column.cast(pa.float64(), safe=False).to_numpy()
    return np.array(value, np.float64)


def _parse_column(table: Table, name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
    if _is_number(column):
        return column.cast(pa.float64())
    import pyarrow.compute as pc

    column = pc.call_function("utf8_trim_whitespace", [column])
    if _is_number(column):
        return column.cast(pa.float64())
    index = _find_first_text(column)
    shown = str(column[index].as_py())[:40]
    raise table.error(f"is {shown!r}, not a number", index, name)


def _is_number(column: pa.ChunkedArray) -> bool:
    try:
        column.cast(pa.float64())
    except pa.ArrowInvalid:
        return False
    return True


def _find_first_text(column: pa.ChunkedArray) -> int:
    """First cell that is no number, by bisection of casts."""
    low, high = 0, len(column)
    while high - low > 1:
        middle = (low + high) // 2
        if _is_number(column.slice(low, middle - low)):
            low = middle
        else:
            high = middle
    return low
