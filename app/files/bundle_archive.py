"""The zip archive of a measurement bundle, before it is unpacked."""

from __future__ import annotations

import zipfile
from pathlib import Path

from app.errors import BundleError


def check_archive(file: Path, limit_bytes: int) -> None:
    """Refuse an archive that would unpack to more than a limit. Raises BundleError."""
    try:
        with zipfile.ZipFile(file) as archive:
            total = sum(info.file_size for info in archive.infolist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise BundleError(
            "is truncated or not a zip archive",
            file="bundle",
            remedy="send the .zip of a measurement bundle",
        ) from error
    if total > limit_bytes:
        raise BundleError(
            f"unpacks to {total >> 20} MiB, more than {limit_bytes >> 20} MiB",
            file="bundle",
            remedy="use tracker.parquet, or raise max_upload_mb",
        )
