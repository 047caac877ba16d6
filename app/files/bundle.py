"""The measurement bundle of the file formats, a folder or a .zip, to and from a Run.

A bundle that cannot be used is one BundleError naming file, row and column; rows are
counted as `tables` says. What a bundle does not carry is left behind on export: axis
samples, events, the tracker's counter.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path as FilePath

from app.errors import BundleError
from app.files.bundle_files import FILES, BundleFiles, open_bundle
from app.files.commanded_file import decode_path, decode_points, encode_commanded
from app.files.machine_file import decode_machine, encode_machine
from app.files.recorded_files import (
    decode_environment,
    decode_reference,
    decode_stream,
    encode_environment,
    encode_reference,
    encode_stream,
)
from app.files.run import Run
from app.files.whole_files import write_files
from app.kinematics.machine import Machine
from app.motion.configurations import Configurations
from drivers.interfaces.records import Path


def read_bundle(path: str | FilePath) -> Run:
    """Read a bundle from a folder or a .zip. Raises BundleError."""
    with open_bundle(path) as files:
        machine = decode_machine(_read_required(files, "machine.json"))
        commanded = _read_commanded(files, machine)
        tracker_file = _choose_file(files, "tracker.parquet", "tracker.csv")
        stream = files.read(tracker_file)
        environment, reference = "environment.csv", "reference.csv"
        return Run(
            name=_choose_name(FilePath(path)),
            machine=machine,
            commanded=commanded,
            tracker=decode_stream(stream, file=tracker_file),
            temperature=decode_environment(files.read(environment))
            if environment in files
            else None,
            reference=decode_reference(files.read(reference))
            if reference in files
            else (),
            provenance={
                "source": FilePath(path).name,
                f"{tracker_file} sha256": hashlib.sha256(stream).hexdigest(),
            },
        )


def write_bundle(run: Run, folder: str | FilePath) -> None:
    """Write a Run as a bundle, each file whole or not at all.

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
    """Return a Run as a zipped bundle, its files in a folder of the Run's name."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in _encode_files(run).items():
            packed = name.endswith(".parquet")
            method = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
            archive.writestr(f"{_make_folder_name(run.name)}/{name}", data, method)
    return sink.getvalue()


def _encode_files(run: Run) -> dict[str, bytes]:
    commanded = "path.csv" if isinstance(run.commanded, Path) else "points.csv"
    files = {
        "machine.json": encode_machine(run.machine),
        commanded: encode_commanded(run.commanded),
        "tracker.parquet": encode_stream(run.tracker),
    }
    if run.temperature is not None and len(run.temperature.time_s):
        files["environment.csv"] = encode_environment(run.temperature)
    if run.reference:
        files["reference.csv"] = encode_reference(run.reference)
    return files


def _make_folder_name(name: str) -> str:
    kept = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    return kept.strip(".") or "bundle"


def _choose_name(path: FilePath) -> str:
    place = path.resolve()
    return place.name if place.is_dir() else place.stem


def _read_commanded(files: BundleFiles, machine: Machine) -> Path | Configurations:
    name = _choose_file(files, "path.csv", "points.csv")
    decode = decode_path if name == "path.csv" else decode_points
    return decode(files.read(name), machine)


def _read_required(files: BundleFiles, name: str) -> bytes:
    if name not in files:
        raise BundleError(
            "is missing from the bundle", file=name, remedy="add the file"
        )
    return files.read(name)


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
