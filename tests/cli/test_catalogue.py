"""`catalogue check` and `catalogue rebuild`, and a service that meets a damaged one."""

from __future__ import annotations

import pytest

from truepath.catalogue.data_folder import hold_folder
from truepath.cli.command import run


@pytest.fixture(autouse=True)
def logged_plainly(plain_log):
    """The command sets the log up; it is put back."""


@pytest.fixture
def folder(tmp_path):
    """A data folder whose catalogue is garbage."""
    (tmp_path / "catalogue.sqlite").write_bytes(b"garbage " * 99)
    return tmp_path


@pytest.mark.parametrize("command", [("catalogue", "check"), ("serve",)])
@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_one_line_with_the_way_out(command, folder, capsys):
    assert run([*command, "--data-dir", str(folder)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{folder / 'catalogue.sqlite'}: is not a SQLite file" in said
    assert "truepath catalogue rebuild" in said
    assert (folder / "catalogue.sqlite").read_bytes() == b"garbage " * 99


def test_rebuilding_says_what_came_back_and_where_the_old_one_is(folder, capsys):
    assert run(["catalogue", "rebuild", "--data-dir", str(folder)]) == 0
    said = capsys.readouterr().out
    (aside,) = folder.glob("catalogue.aside-*.sqlite")
    assert str(aside) in said
    assert "added: 0 Runs, 0 jobs" in said
    assert run(["catalogue", "check", "--data-dir", str(folder)]) == 0
    assert "in order, schema" in capsys.readouterr().out


def test_json_is_one_object(folder, summary):
    assert run(["catalogue", "rebuild", "--data-dir", str(folder), "--json"]) == 0
    assert summary()["schema"] == "catalogue-rebuild/1"
    assert run(["catalogue", "check", "--data-dir", str(folder), "--json"]) == 0
    assert summary()["jobs"] == 0


def test_a_folder_without_a_catalogue_has_none_yet(tmp_path, capsys):
    assert run(["catalogue", "check", "--data-dir", str(tmp_path)]) == 0
    assert "there is none yet" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_rebuilt_under_a_running_service(folder, capsys):
    with hold_folder(folder):
        assert run(["catalogue", "rebuild", "--data-dir", str(folder)]) == 1
    assert "another instance works on" in capsys.readouterr().err


def test_runs_that_do_not_fit_the_catalogue_are_told(folder, capsys, summary):
    run(["catalogue", "rebuild", "--data-dir", str(folder)])
    (folder / "runs" / "left.sqlite").write_bytes(b"no Run")
    assert run(["catalogue", "check", "--data-dir", str(folder)]) == 0
    assert "Run left is on disk and in no row" in capsys.readouterr().err
    assert run(["catalogue", "rebuild", "--data-dir", str(folder), "--json"]) == 0
    assert "left.sqlite: is not a Run file" in summary()["unreadable"]["run left"]
