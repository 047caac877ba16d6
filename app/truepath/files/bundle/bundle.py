"""The measurement bundle of the file formats, a folder or a .zip, to and from a Run.

A bundle that cannot be used is one BundleError naming file, row and column; rows are
counted as in `tables`. Axis samples, events and the tracker's counter have no place in
a bundle and are lost on export.

Nothing is ever extracted: members are read into memory, by name, up to a limit each, so
an archive can neither leave its folder nor fill the disk.
"""

from __future__ import annotations

import hashlib
import io
import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path as FilePath
from pathlib import PurePosixPath
from typing import Any

from truepath.documents.file_model import encode_json, parse_json, quote
from truepath.documents.whole_files import MAX_TEXT_BYTES, write_files
from truepath.errors import BundleError
from truepath.files.bundle.commanded_file import decode_commanded, encode_commanded
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.bundle.recorded_files import (
    KNOWN_LENGTHS,
    add_known_lengths,
    decode_environment,
    decode_known_lengths,
    decode_reference,
    decode_tracker,
    encode_environment,
    encode_known_lengths,
    encode_reference,
    encode_stream,
)
from truepath.files.bundle.run import (
    IMPLAUSIBLE,
    SENSOR_KINDS,
    PointRows,
    Run,
    RunEvent,
)
from truepath.files.environment import (
    Refraction,
    correct_refraction,
    find_missing,
    refraction_from_json,
    refraction_to_json,
    state_facts,
)
from truepath.motion.configurations import Commanded
from truepath_drivers.interfaces.records import Path

FILES = (
    "machine.json",
    "path.csv",
    "points.csv",
    "tracker.parquet",
    "tracker.csv",
    "environment.csv",
    "reference.csv",
    KNOWN_LENGTHS,
)
MAX_BYTES = 4 << 30
MAX_MEMBERS = 1000

_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    OSError,
    ValueError,
)
"""What `zipfile` raises on a damaged member, by its method of packing."""

BundleFiles = Mapping[str, Callable[[], bytes]]
"""What reads each of `FILES` that is there. Raises BundleError if one is too large or
damaged."""


_ENVIRONMENT = "environment"  # what environment.csv cannot hold
_STARTED = "started"
_TOLD, _LEFT_OUT = "told", "left_out"


def read_bundle(
    path: str | FilePath, on_file: Callable[[str], None] = lambda _: None
) -> Run:
    """Read a bundle from a folder or a .zip. Raises BundleError.

    on_file : receives the name of each file before it is read
    """
    with _open_bundle(path, on_file) as files:
        if "machine.json" not in files:
            raise BundleError(
                "is missing from the bundle", file="machine.json", remedy="add the file"
            )
        content = parse_json(files["machine.json"](), "machine.json")
        machine = machine_from_json(content)
        refraction, events = _read_environment(content)
        commanded_file = _choose_file(files, "path.csv", "points.csv")
        data = files[commanded_file]()
        is_path = commanded_file == "path.csv"
        commanded = decode_commanded(data, machine, commanded_file, is_path=is_path)
        tracker_file = _choose_file(files, "tracker.parquet", "tracker.csv")
        stream = files[tracker_file]()
        tracker, points = decode_tracker(stream, file=tracker_file)
        _require_rows(points, commanded, tracker_file)
        environment = files.get("environment.csv")
        temperature, air, doubted = None, None, ()
        if environment:
            temperature, air, doubted = decode_environment(
                environment(), machine.altitude_m
            )
        reference = files.get("reference.csv")
        stated = refraction
        refraction, tracker = correct_refraction(
            refraction, tracker, temperature, air, machine.altitude_m
        )
        place = FilePath(path).resolve()
        run = Run(
            name=place.name if place.is_dir() else place.stem,
            machine=machine,
            commanded=commanded,
            tracker=tracker,
            points=points,
            temperature=temperature,
            air=air,
            refraction=refraction,
            events=(*events, *doubted),
            reference=decode_reference(reference()) if reference else (),
            stream_file=tracker_file,
            provenance={
                **_read_start(content),
                "source": FilePath(path).name,
                f"{tracker_file} sha256": hashlib.sha256(stream).hexdigest(),
            },
        )
        if (known := files.get(KNOWN_LENGTHS)) is None:
            return run
        lengths = decode_known_lengths(known())
        if refraction.by == stated.by:  # as they are, like the samples
            return replace(run, known_lengths=lengths)
        return add_known_lengths(run, lengths)


def write_bundle(run: Run, folder: str | FilePath) -> None:
    """Write a Run as a bundle, each file completely or not at all.

    Raises BundleError if the folder holds a file of another bundle that this one would
    not replace: the two together would contradict each other.
    """
    place = FilePath(folder)
    files = _encode_files(run)
    for name in FILES:
        if name not in files and (place / name).exists():
            raise BundleError(
                "of another bundle is in the folder",
                file=str(place / name),
                remedy="write to an empty folder",
            )
    write_files(place, files)


def zip_bundle(run: Run) -> bytes:
    """The files are in a folder of the Run's name."""
    kept = "".join(c if c.isalnum() or c in "-_." else "-" for c in run.name)
    folder = kept.strip(".") or "bundle"
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in _encode_files(run).items():
            packed = name.endswith(".parquet")
            method = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
            archive.writestr(f"{folder}/{name}", data, method)
    return sink.getvalue()


def check_archive(file: FilePath, limit_bytes: int) -> None:
    """Raise BundleError for an archive that would unpack to more than a limit."""
    remedy = "send the .zip of a measurement bundle"
    with _open_archive(file, "bundle", remedy) as archive:
        total = sum(info.file_size for info in archive.infolist())
    if total > limit_bytes:
        raise BundleError(
            f"unpacks to {total >> 20} MiB, more than {limit_bytes >> 20} MiB",
            file="bundle",
            remedy="use tracker.parquet, or raise max_upload_mb",
        )


def _encode_files(run: Run) -> dict[str, bytes]:
    commanded = "path.csv" if isinstance(run.commanded, Path) else "points.csv"
    machine = machine_to_json(run.machine)
    if _STARTED in run.provenance:
        machine[_STARTED] = run.provenance[_STARTED]
    machine |= _describe_environment(run)
    files = {
        "machine.json": encode_json(machine, indent=1),
        commanded: encode_commanded(run.commanded),
        "tracker.parquet": encode_stream(run.tracker, run.points),
    }
    if environment := encode_environment(run.temperature, run.air):
        files["environment.csv"] = environment
    if run.reference:
        files["reference.csv"] = encode_reference(run.reference)
    if run.known_lengths:
        files[KNOWN_LENGTHS] = encode_known_lengths(run.known_lengths)
    return files


def _require_rows(points: PointRows | None, commanded: Commanded, file: str) -> None:
    if points is None:
        return
    if isinstance(commanded, Path):
        remedy = "leave the column out: a path is measured on the way"
        raise BundleError(
            "names points of a path", file=file, column="point", remedy=remedy
        )
    if int(points.row.max()) >= len(commanded):
        problem = f"names point {points.row.max() + 1} of {len(commanded)}"
        remedy = "count the rows of points.csv from 1"
        raise BundleError(problem, file=file, column="point", remedy=remedy)


def _choose_file(files: BundleFiles, first: str, second: str) -> str:
    if first in files and second in files:
        raise BundleError(
            f"stands beside {second}",
            file=first,
            remedy="a bundle holds one of the two",
        )
    if first not in files and second not in files:
        raise BundleError(
            f"is missing from the bundle, and so is {second}",
            file=first,
            remedy="add one of the two",
        )
    return first if first in files else second


@contextmanager
def _open_bundle(
    path: str | FilePath, on_file: Callable[[str], None]
) -> Iterator[BundleFiles]:
    place = FilePath(path)
    if place.is_dir():
        files = [place / name for name in FILES]
        yield {
            file.name: partial(_read_file, file, on_file)
            for file in files
            if file.is_file()
        }
    elif place.is_file():
        remedy = "give the folder of a bundle or a .zip of it"
        with _open_archive(place, place.name, remedy) as archive:
            yield {
                name: partial(_read_member, archive, member, name, on_file)
                for name, member in _list_members(archive, place.name).items()
            }
    else:
        raise BundleError(
            "no such folder or file", file=str(path), remedy="check the path"
        )


def _limit(name: str) -> int:
    return MAX_BYTES if name.startswith("tracker.") else MAX_TEXT_BYTES


def _too_large(name: str) -> BundleError:
    return BundleError(f"is larger than {_limit(name) >> 20} MiB", file=name)


def _read_file(file: FilePath, on_file: Callable[[str], None]) -> bytes:
    on_file(file.name)
    if file.stat().st_size > _limit(file.name):
        raise _too_large(file.name)
    return file.read_bytes()


def _read_member(
    archive: zipfile.ZipFile,
    member: zipfile.ZipInfo,
    name: str,
    on_file: Callable[[str], None],
) -> bytes:
    on_file(name)
    limit = _limit(name)
    try:
        with archive.open(member) as source:
            data = source.read(limit + 1)
    except _DAMAGED as error:
        raise BundleError(
            "is damaged in the archive", file=name, remedy="pack it again"
        ) from error
    except (RuntimeError, NotImplementedError) as error:
        raise BundleError(
            f"cannot be unpacked ({error})",
            file=name,
            remedy="pack it without a password, with the deflate method",
        ) from error
    if len(data) > limit:
        raise _too_large(name)
    return data


def _open_archive(file: FilePath, label: str, remedy: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(file)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        problem = "is truncated or not a zip archive"
        raise BundleError(problem, file=label, remedy=remedy) from error


def _list_members(archive: zipfile.ZipFile, label: str) -> dict[str, zipfile.ZipInfo]:
    named = [info for info in archive.infolist() if info.filename.strip("./")]
    infos = [info for info in named if not info.is_dir()]
    if len(infos) > MAX_MEMBERS:
        raise BundleError(f"holds more than {MAX_MEMBERS} files", file=label)
    found: dict[str, zipfile.ZipInfo] = {}
    folders: set[str] = set()
    for info in infos:
        member = PurePosixPath(info.filename.replace("\\", "/"))
        if member.is_absolute() or ".." in member.parts or ":" in member.parts[0]:
            raise BundleError(
                f"member {info.filename!r} points out of the archive",
                file=label,
                remedy="pack the folder of the bundle itself",
            )
        if member.name not in FILES or len(member.parts) > 2:
            continue
        if member.name in found:
            raise BundleError("is in the archive twice", file=member.name)
        found[member.name] = info
        folders.add(str(member.parent))
    if len(folders) > 1:
        raise BundleError(
            f"spreads a bundle over {', '.join(sorted(folders))}",
            file=label,
            remedy="pack one folder",
        )
    return found


def _describe_environment(run: Run) -> dict[str, Any]:
    time_s = run.tracker.device_time_s
    content: dict[str, Any] = {}
    if len(time_s):
        span = float(time_s[0]), float(time_s[-1])
        missing = find_missing(state_facts(run.temperature, run.air, *span))
        content |= {"missing": missing} if missing else {}
    told = [event.text for event in run.events if event.kind in SENSOR_KINDS]
    content |= {_TOLD: list(dict.fromkeys(told))} if told else {}
    wrong = [event.text for event in run.events if event.kind == IMPLAUSIBLE]
    content |= {_LEFT_OUT: list(dict.fromkeys(wrong))} if wrong else {}
    if run.refraction != Refraction():
        content["refraction"] = refraction_to_json(run.refraction)
    return {_ENVIRONMENT: content} if content else {}


def _read_start(content: Any) -> dict[str, str]:
    """When the Run began, by ISO 8601, where it is stated. Raises BundleError."""
    stated = content.get(_STARTED) if isinstance(content, dict) else None
    if stated is None:
        return {}
    with suppress(ValueError):
        at = datetime.fromisoformat(str(stated))
        return {_STARTED: (at if at.tzinfo else at.astimezone()).isoformat()}
    raise BundleError(
        f"started is {quote(stated)}",
        file="machine.json",
        remedy='write "started": "2026-11-24T08:30:00+01:00"',
    )


def _read_environment(content: Any) -> tuple[Refraction, tuple[RunEvent, ...]]:
    """Refraction, and events of missing or implausible sensors.

    content : of machine.json. Raises BundleError.
    """
    stated = content.get(_ENVIRONMENT) if isinstance(content, dict) else None
    if stated is None:
        return Refraction(), ()
    try:
        refraction = refraction_from_json(stated.get("refraction"))
        missing = [f"{name}: {why}" for name, why in stated.get("missing", {}).items()]
        wrong = [str(text) for text in stated.get(_LEFT_OUT, ())]
        kinds = dict.fromkeys(
            [*map(str, stated.get(_TOLD, ())), *missing], "sensor-silent"
        )
        kinds |= dict.fromkeys(wrong, IMPLAUSIBLE)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BundleError(
            f"cannot be understood ({error})",
            file="machine.json",
            column=_ENVIRONMENT,
            remedy="leave the key as it was exported, or leave it out",
        ) from error
    return refraction, tuple(RunEvent(0, kind, text) for text, kind in kinds.items())
