"""One zip file for support: description and logs of an installation.

Every text passes the redactor, so that no password, key or token leaves the plant. A
missing part is named with the reason; the others are written all the same.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.metadata import distributions, version
from pathlib import Path

from truepath.catalogue.database import Database
from truepath.catalogue.job import encode_job, format_utc_now
from truepath.catalogue.store import Store
from truepath.errors import BadInput, TruepathError
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.operation.doctor import examine
from truepath.operation.running_service import find_service, read_metrics
from truepath.operation.settings_text import Redactor, redact_settings, write_toml
from truepath.settings import Settings

_JOBS = 100
_NO_LOG = "log_file is not set; see the journal of the system"


@dataclass(frozen=True, slots=True)
class SupportBundle:
    """Written parts with their sizes, and reasons for missing ones."""

    parts: dict[str, int]
    missing: dict[str, str]


class _Absent(Exception):
    pass


def write_support_bundle(
    settings: Settings, file: Path, max_bytes: int
) -> SupportBundle:
    """Write a zip file of at most so many bytes; the ends of log files are included.

    Raises BadInput where a file is there already.
    """
    redactor = Redactor(settings)
    parts, missing = _collect(settings, redactor)
    left = max_bytes - sum(map(len, parts.values()))
    logs = dict(_read_logs(settings, redactor, left))
    if not logs:
        missing["logs"] = (
            _NO_LOG if settings.log is None else "there is no log file yet"
        )
    parts |= logs
    sizes = {name: len(content) for name, content in parts.items()}
    summary = {
        "schema": "support-bundle/1",
        "created": format_utc_now(),
        "parts": sizes,
        "missing": missing,
    }
    parts["summary.json"] = _as_text(summary).encode()
    _write_zip(file, parts)
    return SupportBundle(sizes, missing)


def _collect(
    settings: Settings, redactor: Redactor
) -> tuple[dict[str, bytes], dict[str, str]]:
    sources: dict[str, Callable[[Settings], str]] = {
        "settings.toml": _show_settings,
        "versions.json": _show_versions,
        "doctor.json": _show_findings,
        "catalogue.json": _show_catalogue,
        "jobs.json": _show_jobs,
        "metrics.txt": _show_metrics,
    }
    parts: dict[str, bytes] = {}
    missing: dict[str, str] = {}
    for name, show in sources.items():
        try:
            parts[name] = redactor.redact(show(settings)).encode()
        except (TruepathError, _Absent, OSError) as error:
            missing[name] = redactor.redact(str(error))
    return parts, missing


def _show_settings(settings: Settings) -> str:
    shown = redact_settings(settings)
    lines = (f"{name} = {write_toml(v)}\n" for name, v in shown if v is not None)
    return "".join(lines)


def _show_versions(_settings: Settings) -> str:
    installed = {one.metadata["Name"]: one.version for one in distributions()}
    return _as_text(
        {
            "truepath": version("truepath"),
            "python": sys.version,
            "system": platform.platform(),
            "processors": os.cpu_count(),
            "libraries": dict(sorted(installed.items())),
        }
    )


def _show_findings(settings: Settings) -> str:
    return _as_text([asdict(one) for one in examine(settings)])


def _show_catalogue(settings: Settings) -> str:
    with closing(Database(settings.database)) as database:
        return _as_text(check_against_disk(database, settings.data_dir / "runs"))


def _show_jobs(settings: Settings) -> str:
    with closing(Database(settings.database)) as database:
        if database.check() is None:
            raise _Absent("there is no catalogue yet")
        jobs = Store(database, lambda _: None).list_page(_JOBS)
    return _as_text([encode_job(job) for job in jobs])


def _show_metrics(settings: Settings) -> str:
    if not find_service(settings).is_there:
        raise _Absent("the service does not run")
    text = read_metrics(settings)
    if text is None:
        raise _Absent("the service does not answer here, or wants a log-in first")
    return text


def _read_logs(
    settings: Settings, redactor: Redactor, room: int
) -> Iterator[tuple[str, bytes]]:
    """Ends of the log files within the limit, the newest first."""
    for file in [] if settings.log is None else settings.log.list_files():
        if room <= 0:
            return
        with file.open("rb") as source:
            size = source.seek(0, os.SEEK_END)
            source.seek(max(0, size - room))
            if size > room:
                source.readline()  # a line that is cut
            content = source.read(room)
        text = redactor.redact(content.decode("utf-8", "replace")).encode()[-room:]
        room -= len(text)
        yield f"logs/{file.name}", text


def _write_zip(file: Path, parts: dict[str, bytes]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        # Its content is private to this account.
        handle = os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    except FileExistsError as error:
        raise BadInput(f"{file}: is there already; name another file") from error
    with (
        os.fdopen(handle, "wb") as sink,
        zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, content in parts.items():
            archive.writestr(name, content)


def _as_text(content: object) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False)
