"""Archives that must not be unpacked are refused before they are."""

import zipfile

import pytest

from truepath.errors import BundleError
from truepath.files.bundle.bundle import check_archive


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path):
    bomb = tmp_path / "bomb.zip"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tracker.csv", b"0" * (3 << 20))
    check_archive(bomb, 4 << 20)
    with pytest.raises(BundleError, match="unpacks to 3 MiB, more than 2 MiB"):
        check_archive(bomb, 2 << 20)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive"])
def test_what_is_no_archive_is_refused(tmp_path, content):
    file = tmp_path / "bundle.zip"
    file.write_bytes(content)
    with pytest.raises(BundleError, match="not a zip archive"):
        check_archive(file, 1 << 20)
