"""Files that are read and written whole, or not at all."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from truepath.documents import whole_files
from truepath.documents.whole_files import read_whole, replace_file
from truepath.errors import BundleError


def test_what_was_written_is_read_unless_it_is_larger_than_it_may_be(tmp_path):
    file = tmp_path / "a.json"
    replace_file(file, b"old")
    replace_file(file, b"new")
    assert read_whole(file) == b"new"
    assert [one.name for one in tmp_path.iterdir()] == ["a.json"]
    file = tmp_path / "large.csv"
    file.write_bytes(b"x" * ((1 << 20) + 1))
    assert len(read_whole(file)) == (1 << 20) + 1
    with pytest.raises(BundleError, match=r"large\.csv.*is larger than 1 MiB"):
        read_whole(file, largest_bytes=1 << 20)


def test_two_threads_may_write_one_file_at_once(tmp_path, monkeypatch):
    file, both = tmp_path / "map.json", threading.Barrier(2, timeout=5)
    sync = os.fsync
    waits = threading.local()

    def sync_together(handle):
        if not hasattr(waits, "done"):
            waits.done = True
            both.wait()
        sync(handle)

    monkeypatch.setattr(whole_files.os, "fsync", sync_together)
    with ThreadPoolExecutor(2) as pool:
        writes = [pool.submit(replace_file, file, word * 999) for word in (b"a", b"b")]
        assert [one.result(10) for one in writes] == [None, None]
    assert set(file.read_bytes()) in ({ord("a")}, {ord("b")})
    assert [each.name for each in tmp_path.iterdir()] == ["map.json"]
