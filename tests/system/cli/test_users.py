"""`users`, `keys` and `audit`, on the computer of the service itself."""

import io
import json

import pytest
from sqlalchemy import text

from truepath.catalogue.database import Database
from truepath.cli.command import run
from truepath.users.access import Access, AccessRules
from truepath.users.roles import Actor, Role

PASSWORD = "a long sentence is easy"
pytestmark = pytest.mark.usefixtures("plain_log")  # migrating writes to the log
LOG_IN = {"LOG_IN": "always"}


@pytest.fixture
def call(tmp_path, capsys, monkeypatch):
    def call(*words, says=""):
        monkeypatch.setattr("sys.stdin", io.StringIO(says))
        status = run([*words, "--data-dir", str(tmp_path)])
        said = capsys.readouterr()
        return status, said.out if status == 0 else said.err

    return call


@pytest.fixture
def catalogue(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'catalogue.sqlite'}")
    yield database
    database.close()


def add(call, name, role):
    words = ("users", "add", name, "--role", role, "--password-stdin")
    return call(*words, says=f"{PASSWORD}\n")


def test_users_are_added_before_any_start_change_and_go(call, catalogue):
    assert add(call, "anna", "administrator") == (0, "anna is administrator\n")
    access = Access(catalogue, AccessRules(log_in_required=True))
    assert access.log_in("anna", PASSWORD, "")[1] == Actor("anna", Role.ADMINISTRATOR)
    access.close()
    _, listed = call("users", "list", "--json")
    (user,) = json.loads(listed)["users"]
    assert (user["name"], user["role"]) == ("anna", "administrator")
    add(call, "ben", "viewer")
    assert call("users", "set-role", "ben", "--role", "operator")[0] == 0
    words = ("users", "set-password", "ben", "--password-stdin")
    assert call(*words, says="quite another sentence\n")[0] == 0
    assert "operator" in call("users", "list")[1]
    assert call("users", "remove", "ben")[0] == 0
    assert "ben" not in call("users", "list")[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("add", "anna", "--role", "chief"), "--role chief: not one of viewer"),
        (("add", "anna", "--role", "viewer"), "no terminal to ask for a password"),
        (("remove", "anna"), "there is no user anna"),
    ],
)
def test_what_cannot_be_is_one_line(call, words, said):
    status, line = call("users", *words)
    assert status != 0
    assert said in line
    assert line.count("\n") == 1


def test_a_key_is_printed_once_and_revoked(call, catalogue):
    _, token = call("keys", "create", "plant", "--days", "2")
    access = Access(catalogue, AccessRules(log_in_required=True))
    assert access.identify(token.strip()).role is Role.SERVICE
    _, listed = call("keys", "list")
    assert "plant" in listed
    assert "2.0 days left" in listed
    assert token.strip() not in listed
    assert call("keys", "revoke", "plant")[0] == 0
    assert access.identify(token.strip()) is None
    access.close()


def test_the_audit_log_is_verified_and_exported(call, catalogue, tmp_path):
    add(call, "anna", "administrator")
    call("keys", "create", "plant")
    status, said = call("audit", "verify")
    assert (status, said[:31]) == (0, "2 rows, each as it was written;")
    call("audit", "export", "-o", str(tmp_path / "audit.jsonl"))
    lines = (tmp_path / "audit.jsonl").read_text().splitlines()
    what = [json.loads(line)["what"] for line in lines]
    assert what == ["users add anna", "keys create plant"]
    assert call("audit", "export")[1].splitlines() == lines
    with catalogue.engine.begin() as connection:
        connection.execute(text("DROP TRIGGER audit_no_delete"))
        connection.execute(text("DELETE FROM audit WHERE seq = 1"))
    status, said = call("audit", "verify")
    assert status == 1
    assert "row 1 is missing" in said


def test_a_certificate_is_made_with_its_settings(call, tmp_path):
    status, said = call("tls", "create", "localhost", "192.0.2.10")
    assert status == 0
    both = [f'tls_{kind} = "{tmp_path}/tls/{kind}.pem"' for kind in ("cert", "key")]
    assert said.splitlines() == both


@pytest.mark.parametrize(
    ("settings", "words", "said"),
    [
        (LOG_IN, ["--port", "0"], "truepath users add NAME --role administrator"),
        (LOG_IN, ["--simulated", "--measure"], "begins with nobody logged in"),
        ({"TLS_CERT": "c.pem", "TLS_KEY": "k"}, ["--port", "0"], "setting tls_cert"),
    ],
    ids=["no user", "nobody logged in", "no certificate"],
)
def test_a_service_that_nobody_could_log_in_to_safely_does_not_start(
    settings, words, said, command, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name, value in settings.items():
        monkeypatch.setenv(f"TRUEPATH_{name}", value)
    assert said in command.refuse("serve", "--data-dir", tmp_path / "data", *words)
