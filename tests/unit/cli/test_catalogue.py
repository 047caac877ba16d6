"""`catalogue check` and `catalogue rebuild`, and a service that meets a damaged one."""

import pytest

from truepath.catalogue.locks import hold_folder
from truepath.cli.command import run

pytestmark = pytest.mark.usefixtures("plain_log")  # the command sets the log up


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "catalogue.sqlite").write_bytes(b"garbage " * 99)
    return tmp_path


@pytest.fixture
def words(tmp_path):
    return lambda verb: ("catalogue", verb, "--data-dir", tmp_path)


@pytest.mark.parametrize("command", [("catalogue", "check"), ("serve",)])
@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_one_line_with_the_way_out(command, folder, capsys):
    assert run([*command, "--data-dir", str(folder)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{folder / 'catalogue.sqlite'}: is not a SQLite file" in said
    assert "truepath catalogue rebuild" in said
    assert (folder / "catalogue.sqlite").read_bytes() == b"garbage " * 99


def test_rebuilding_says_what_came_back_and_where_the_old_is(folder, command, words):
    with hold_folder(folder):  # under a service that runs
        said = command.refuse(*words("rebuild"), status=1)
    assert "another instance works on" in said
    said = command.run(*words("rebuild")).out
    (aside,) = folder.glob("catalogue.aside-*.sqlite")
    assert str(aside) in said
    assert "added: 0 Runs, 0 jobs" in said
    assert "in order, schema" in command.run(*words("check")).out
    assert command.json(*words("check"))["jobs"] == 0
    (folder / "runs" / "left.sqlite").write_bytes(b"no Run")
    said = command.run(*words("check")).err
    assert "Run left is on disk and in no row" in said
    told = command.json(*words("rebuild"))
    assert told["schema"] == "catalogue-rebuild/1"
    assert "left.sqlite: is not a Run file" in told["unreadable"]["run left"]


def test_a_folder_without_a_catalogue_has_none_yet(command, words, tmp_path):
    assert "there is none yet" in command.run(*words("check")).out
    assert list(tmp_path.iterdir()) == []
