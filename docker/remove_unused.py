"""Remove from an installed environment what the service never loads.

usage: python remove_unused.py FOLDER

Only for the image: a third of what the libraries install are their own tests, headers
and parts for other uses. `tests/system/project/test_image.py` runs the main job, an
upload and a report on what is left.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

_UNUSED = (
    "numpy/**/tests",
    "scipy/**/tests",
    "pyarrow/tests",
    "pyarrow/include",
    "pyarrow/src",
    "pyarrow/**/*.p[xy][dix]",
    # Arrow over networks and in cloud stores: files are local.
    "pyarrow/libarrow_flight.so*",
    "pyarrow/libarrow_s3.so*",
    "pyarrow/_flight*",
    "pyarrow/_s3fs*",
    # Of plotly the page takes the script alone.
    "plotly/graph_objs",
    "plotly/labextension",
    "plotly/validators",
)


def find_unused(site_packages: Path) -> Iterator[Path]:
    """Yield files and folders to remove. Raises LookupError for a rule without any."""
    for pattern in _UNUSED:
        found = sorted(site_packages.glob(pattern))
        if not found:
            raise LookupError(f"nothing is {pattern}; the library has changed")
        yield from found


def remove(path: Path) -> None:
    """Remove a file, or a folder with what is in it."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def main(folder: Path) -> None:
    """Remove what is not used from the environment in this folder."""
    (site_packages,) = folder.glob("lib/python3*/site-packages")
    for path in list(find_unused(site_packages)):
        if path.exists():  # a folder above it may have been removed
            remove(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
