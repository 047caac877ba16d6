"""The log of the service: one stream on standard error, child processes included.

A child sends its records through a pipe and its parent handles them as if they were its
own, so that every line passes the same level and the same format. A record names the
process it comes from. Writing a record never waits for the parent: a thread of the
child sends it. If the parent is gone, the record goes to the child's standard error. So
the parent alone writes to the log file, and can rotate a full one.
"""

from __future__ import annotations

import copy
import logging
import os
import queue
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from logging.handlers import RotatingFileHandler
from multiprocessing.connection import Connection
from pathlib import Path

import structlog

from truepath.errors import BadInput
from truepath_drivers import host_clock

_MAIN_PROCESS = "MainProcess"
_SEND_REST_S = 1.0
_SHARED: tuple[structlog.typing.Processor, ...] = (
    structlog.contextvars.merge_contextvars,
    structlog.stdlib.add_log_level,
    structlog.stdlib.add_logger_name,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
    structlog.processors.StackInfoRenderer(),
)


@dataclass(frozen=True, slots=True)
class LogFile:
    """Log file in addition to standard error.

    max_bytes : of one file; a full one becomes `NAME.1`, the one before `NAME.2`, …
    count : of older files that are kept
    """

    path: Path
    max_bytes: int
    count: int

    def list_files(self) -> list[Path]:
        """Existing files, the newest first."""
        names = (f"{self.path.name}.{n}" for n in range(1, self.count + 1))
        files = [self.path, *(self.path.with_name(name) for name in names)]
        return [file for file in files if file.is_file()]


def configure_log(level: str, log_format: str, file: LogFile | None = None) -> None:
    """Send every line, ours and the libraries', through structlog to standard error.

    log_format : `json`, else lines to read
    file : receives each line as JSON as well

    Raises BadInput where the file cannot be written.
    """
    _configure_structlog(*_SHARED)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_make_formatter(log_format))
    root = logging.getLogger()
    root.handlers = [handler] if file is None else [handler, _open_file(file)]
    root.setLevel(level.upper())
    for name in ("uvicorn.error", "uvicorn", "alembic", "httpx2"):
        quiet = max(logging.WARNING, root.level)
        logging.getLogger(name).setLevel(quiet)


def read_log_settings() -> tuple[int, bool]:
    """Level of the log, and whether structlog writes to it or prints."""
    return logging.getLogger().level, structlog.is_configured()


@contextmanager
def send_log(records: Connection, settings: tuple[int, bool]) -> Iterator[None]:
    """Send log records of this process to its parent until the end of the block.

    settings : of the parent, from `read_log_settings`
    """
    level, is_structured = settings
    waiting: queue.SimpleQueue[logging.LogRecord | None] = queue.SimpleQueue()
    sender = threading.Thread(
        target=_send_records, args=(waiting, records), name="log-sender", daemon=True
    )
    root = logging.getLogger()
    root.handlers = [_QueueHandler(waiting)]
    root.setLevel(level)
    if is_structured:
        _configure_structlog(*_SHARED, structlog.processors.format_exc_info)
    sender.start()
    try:
        yield
    finally:
        waiting.put(None)
        host_clock.join(sender, _SEND_REST_S)


def receive_log(records: Connection) -> None:
    """Handle the records of a child until it ends. Body of a thread of the parent."""
    while True:
        try:
            record = records.recv()
        except (EOFError, OSError):
            records.close()
            return
        logging.getLogger(record.name).handle(record)


def _make_formatter(log_format: str) -> logging.Formatter:
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*_SHARED, _add_trace],
        processors=[_add_process, *_rendering(log_format)],
    )


def _open_file(file: LogFile) -> logging.Handler:
    try:
        file.path.parent.mkdir(parents=True, exist_ok=True)
        handler = RotatingFileHandler(
            file.path,
            maxBytes=file.max_bytes,
            backupCount=file.count,
            encoding="utf-8",
        )
    except OSError as error:
        raise BadInput(
            f"setting log_file: {file.path}: {error.strerror}; name a file that the "
            "account of the service may write"
        ) from error
    handler.setFormatter(_make_formatter("json"))
    return handler


class _QueueHandler(logging.Handler):
    def __init__(self, waiting: queue.SimpleQueue[logging.LogRecord | None]) -> None:
        super().__init__()
        self._waiting = waiting

    def emit(self, record: logging.LogRecord) -> None:
        record = copy.copy(record)
        if not isinstance(record.msg, dict):  # structlog's: the parent formats it
            record.msg = record.getMessage()
        if record.exc_info:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
        record.args = record.exc_info = None
        self._waiting.put(record)


def _send_records(
    waiting: queue.SimpleQueue[logging.LogRecord | None], records: Connection
) -> None:
    while (record := waiting.get()) is not None:
        try:
            records.send(record)
        except Exception:  # the parent is gone, or the record cannot be pickled
            if logging.lastResort is not None:
                logging.lastResort.handle(record)


def _configure_structlog(*processors: structlog.typing.Processor) -> None:
    structlog.configure(
        processors=[
            *processors,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )


def _add_process(
    _logger: object, _method: str, event_dict: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    record = event_dict.get("_record")
    if record is not None and record.processName != _MAIN_PROCESS:
        event_dict["process"] = record.processName
    return event_dict


def _add_trace(
    _logger: object, _method: str, event_dict: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    record = event_dict["_record"]
    if record.exc_text and not record.exc_info:
        event_dict["exception"] = record.exc_text
    return event_dict


def _rendering(log_format: str) -> list[structlog.typing.Processor]:
    remove = structlog.stdlib.ProcessorFormatter.remove_processors_meta
    if log_format == "json":
        return [
            remove,
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ]
    colors = sys.stderr.isatty() and "NO_COLOR" not in os.environ
    # The fancy trace of the default takes seconds and thousands of lines.
    plain = structlog.dev.plain_traceback
    renderer = structlog.dev.ConsoleRenderer(colors=colors, exception_formatter=plain)
    return [remove, renderer]
