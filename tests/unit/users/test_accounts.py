"""Accounts, sessions, keys and certificates of the service; its audit log."""

import os
import ssl
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text
from structlog.testing import capture_logs

from truepath.errors import BadInput, NotFound
from truepath.users import access as limits
from truepath.users import accounts as passwords
from truepath.users import audit, errors
from truepath.users.accounts import is_password
from truepath.users.roles import Actor, Role, includes
from truepath.users.tls import TlsFiles, check_tls_files, create_certificate
from truepath.users.tokens import read_moment

PASSWORD = "a long sentence is easy"


def test_a_password_is_kept_as_argon2id_only(accounts, database):
    _, kept = accounts.find("anna")
    assert kept.startswith("$argon2id$")
    assert is_password(PASSWORD, kept)
    assert not is_password("another sentence", kept)
    with database.read() as connection:
        rows = connection.execute(text("SELECT * FROM users")).all()
    assert PASSWORD not in str(rows)


def test_who_is_not_there_has_no_password_and_is_refused_as_slowly_as_who_is():
    assert not passwords._hasher.check_needs_rehash(passwords._NOBODY)
    assert not is_password("the password of nobody", None)


@pytest.mark.parametrize(
    ("name", "role", "password", "refused"),
    [
        ("ben", Role.VIEWER, "x" * 9, "9 characters; choose 10"),
        ("anna", Role.VIEWER, PASSWORD, "anna already"),
        ("ben", Role.SERVICE, PASSWORD, "role of programs"),
        *(
            (name, Role.VIEWER, PASSWORD, "is no name")
            for name in ("", "-x", "a b", "a\nb", "ä/ö", "x" * 65)
        ),
    ],
)
def test_what_makes_no_user_is_refused(accounts, name, role, password, refused):
    error = errors.UserConflict if name == "anna" else BadInput
    with pytest.raises(error, match=refused):
        accounts.add(name, role, password)


def test_the_last_administrator_stays_and_who_is_not_there_is_not_changed(accounts):
    with pytest.raises(errors.UserConflict, match="last administrator"):
        accounts.remove("anna")
    with pytest.raises(errors.UserConflict, match="last administrator"):
        accounts.set_role("anna", Role.VIEWER)
    for change, words in (
        (accounts.remove, []),
        (accounts.set_password, [PASSWORD]),
        (accounts.set_role, [Role.VIEWER]),
    ):
        with pytest.raises(NotFound, match="no user ben"):
            change("ben", *words)
    accounts.add("ben", Role.ADMINISTRATOR, PASSWORD)
    accounts.remove("anna")
    assert [user.name for user in accounts.list_all()] == ["ben"]


def test_each_role_may_what_those_before_it_may():
    ladder = [Role.VIEWER, Role.OPERATOR, Role.METROLOGIST, Role.ADMINISTRATOR]
    for i, role in enumerate(ladder):
        may = [includes(role, least) for least in ladder]
        assert may == [j <= i for j in range(len(ladder))]
    assert includes(Role.SERVICE, Role.OPERATOR)
    assert not includes(Role.SERVICE, Role.METROLOGIST)


@pytest.fixture
def access(database, accounts):
    access = limits.Access(database, limits.AccessRules(log_in_required=True))
    yield access
    access.close()


def test_who_logs_in_is_known_by_the_token_and_failures_wait(access, monkeypatch):
    token, actor = access.log_in("anna", PASSWORD, "192.0.2.17")
    assert actor == access.identify(token) == Actor("anna", Role.ADMINISTRATOR)
    for name in ("anna", "nobody"):
        with pytest.raises(errors.WrongPassword, match=r"^name and password do not"):
            access.log_in(name, "wrong", "192.0.2.16")
    monkeypatch.setattr("truepath.users.access.is_password", lambda *_: False)
    for _ in range(limits.FREE_TRIES):
        with pytest.raises(errors.WrongPassword):
            access.log_in("anna", "wrong", "192.0.2.17")
    monkeypatch.undo()
    with pytest.raises(errors.TooManyTries, match="try again in 1 s") as refused:
        access.log_in("anna", PASSWORD, "192.0.2.17")
    assert 0 < refused.value.retry_after_s <= 1
    assert access.log_in("anna", PASSWORD, "192.0.2.18"), "another place is not kept"


def test_each_failure_waits_twice_as_long_until_forgotten(hand_clock):
    back_off = limits.BackOff(3)
    waits = []
    for _ in range(16):
        back_off.fail("anna")
        try:
            back_off.check("anna")
        except errors.TooManyTries as error:
            waits.append(error.retry_after_s)
            hand_clock.time_s += error.retry_after_s
            back_off.check("anna")
    assert (waits[:4], waits[-1]) == ([1, 2, 4, 8], limits.LONGEST_WAIT_S)
    back_off.clear("anna")
    for _ in range(31):  # a typo a day
        back_off.fail("anna")
        back_off.check("anna")
        hand_clock.time_s += 24 * 3600
    for _ in range(3):
        back_off.fail("anna")
        hand_clock.time_s += limits.FORGET_S - 1
    back_off.fail("anna")
    with pytest.raises(errors.TooManyTries):
        back_off.check("anna")


def test_a_rate_is_a_burst_and_then_so_many_a_second(hand_clock):
    limit = limits.RateLimit(3, 2.0)
    for _ in range(3):
        limit.count_request("anna")
    with pytest.raises(errors.TooManyRequests) as refused:
        limit.count_request("anna")
    limit.count_request("ben")
    assert refused.value.retry_after_s == pytest.approx(0.5)
    hand_clock.time_s += 0.5
    limit.count_request("anna")
    with pytest.raises(errors.TooManyRequests):
        limit.count_request("anna")


@pytest.fixture
def session(accounts, tokens):
    return tokens.open_session("anna")


def test_a_session_is_kept_as_a_hash_until_its_end(database, tokens, session, clock):
    def read_rows():
        with database.read() as connection:
            return connection.execute(text("SELECT * FROM tokens")).all()

    assert tokens.find(session) == Actor("anna", Role.ADMINISTRATOR)
    assert tokens.find(session + "x") is None
    assert tokens.find("") is None
    (row,) = read_rows()
    assert session not in str(row)
    clock.pass_s(3601)
    tokens.open_session("anna")
    assert len(read_rows()) == 1


@pytest.mark.fault_row(29)
@pytest.mark.parametrize("jump_s", [0, 3 * 3600, -3 * 3600, -1e9])
def test_a_jump_of_the_wall_clock_changes_no_session(tokens, session, clock, jump_s):
    clock.jump_s(jump_s)
    clock.pass_s(3599)
    assert tokens.find(session)
    clock.pass_s(2)
    assert tokens.find(session) is None


def test_the_time_that_the_computer_was_off_counts(tokens, session, clock):
    clock.reboot(down_s=3500)
    assert tokens.find(session)
    clock.reboot(down_s=101)
    assert tokens.find(session) is None
    first, then = read_moment(), read_moment()
    assert first.boot_id == then.boot_id != ""
    assert 0 <= first.age_s(then) < 10


def test_a_change_a_log_out_and_a_removal_count_at_once(accounts, tokens, session):
    accounts.add("ben", Role.ADMINISTRATOR, PASSWORD)
    of_ben, key = tokens.open_session("ben"), tokens.create_key("plant", Role.SERVICE)
    accounts.set_role("anna", Role.VIEWER)
    assert tokens.find(session) == Actor("anna", Role.VIEWER)
    for _ in range(2):  # twice is once
        tokens.end(session)
        assert tokens.find(session) is None
    session = tokens.open_session("anna")
    accounts.set_role("anna", Role.ADMINISTRATOR)
    accounts.set_password("anna", "quite another sentence")
    assert tokens.find(session) is None
    accounts.remove("ben")
    accounts.add("ben", Role.OPERATOR, PASSWORD)
    assert tokens.find(of_ben) is None
    assert tokens.find(key), "a key is of nobody's password"


def test_a_key_is_no_person_and_lasts_until_revoked(accounts, tokens, clock):
    short = tokens.create_key("gauge", Role.SERVICE, days=2)
    key = tokens.create_key("plant", Role.SERVICE)
    clock.pass_s(86400)
    listed = {one.name: one.expires_in_s for one in tokens.list_keys()}
    assert listed == {"gauge": pytest.approx(86400), "plant": None}
    assert tokens.find(short)
    clock.pass_s(86401)
    assert tokens.find(short) is None
    clock.pass_s(1e8)
    assert tokens.find(key) == Actor("plant", Role.SERVICE, is_person=False)
    tokens.revoke_key("plant")
    assert tokens.find(key) is None
    with pytest.raises(NotFound, match="no API key plant"):
        tokens.revoke_key("plant")
    for role in (Role.ADMINISTRATOR, Role.OPERATOR):
        with pytest.raises(BadInput, match="an API key is one of"):
            tokens.create_key("plant", role)
    with pytest.raises(errors.UserConflict):
        tokens.create_key("anna", Role.SERVICE)


@pytest.fixture
def files(tmp_path):
    return create_certificate(["localhost", "127.0.0.1"], tmp_path / "tls", days=30)


def test_one_that_was_made_holds_for_its_days_and_is_not_written_over(files, tmp_path):
    now = datetime.now(UTC)
    assert timedelta(days=29) < check_tls_files(files) - now < timedelta(days=30)
    assert os.stat(files.key).st_mode & 0o777 == 0o600
    for days, said in ((31, "expired on"), (-2, "check the clock of this computer")):
        with pytest.raises(BadInput, match=said):
            check_tls_files(files, now + timedelta(days=days))
    with pytest.raises(BadInput, match="is there already"):
        create_certificate(["localhost"], files.cert.parent, days=1)
    for name in ("", "a b", "https://a", "ä"):
        with pytest.raises(BadInput, match="is no name of a computer"):
            create_certificate([name], tmp_path, days=1)


def test_files_that_cannot_be_used_are_named_by_their_setting(files, tmp_path):
    other = create_certificate(["other"], tmp_path / "other", days=30)
    absent, text = tmp_path / "absent.pem", tmp_path / "text.pem"
    text.write_text("no certificate")
    wrong = {
        r"tls_cert .*absent.pem\): cannot be read: No such": (absent, files.key),
        r"tls_cert .*text.pem\): is no certificate": (text, files.key),
        r"tls_key .*absent.pem\): cannot be read": (files.cert, absent),
        r"tls_key .*text.pem\): is no unencrypted": (files.cert, text),
        r"tls_key .*other/key.pem\): is no unencrypted": (files.cert, other.key),
    }
    for said, (cert, key) in wrong.items():
        with pytest.raises(BadInput, match=said):
            check_tls_files(TlsFiles(cert, key))


def shake_hands(files, trusted, name):
    """Open TLS as a client of a service with these files; return its version."""
    to_client, to_service = ssl.MemoryBIO(), ssl.MemoryBIO()
    here = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    here.load_cert_chain(files.cert, files.key)
    there = ssl.create_default_context(cafile=trusted)
    service = here.wrap_bio(to_service, to_client, server_side=True)
    client = there.wrap_bio(to_client, to_service, server_hostname=name)
    for end in (client, service, client, service):
        with suppress(ssl.SSLWantReadError):
            end.do_handshake()
    return client.version()


def test_a_client_that_trusts_it_is_answered_and_no_other(files):
    for name in ("localhost", "127.0.0.1"):
        assert shake_hands(files, files.cert, name) == "TLSv1.3"
    for trusted, name in ((None, "localhost"), (files.cert, "other")):
        with pytest.raises(ssl.SSLCertVerificationError):
            shake_hands(files, trusted, name)


ENTRY = audit.Entry(
    *("anna", "operator", "192.0.2.17", "6f0e4c1b9a7d4e52", "POST /api/v1/jobs", "202"),
    old={"version": "3"},
    new={"made": "ä"},
)
STRANGER = audit.Entry("", "", "192.0.2.99", "", "POST /api/v1/stop", "202")


@pytest.fixture
def writer(audit_log):
    writer = audit.AuditWriter(audit_log)
    yield writer
    writer.close()


@contextmanager
def locked(database):
    writes = {"truepath_writes": True}
    with database.engine.connect() as raw, raw.execution_options(**writes).begin():
        yield


@pytest.fixture
def audit_log(database):
    return audit.AuditLog(database)


@pytest.fixture
def five(audit_log):
    for number in range(5):
        audit_log.append(replace(ENTRY, outcome=f"20{number}"))
    return audit_log


def test_what_was_written_is_whole(five):
    assert five.verify() == []
    assert [row.entry.outcome for row in five.read()] == [f"20{n}" for n in range(5)]
    assert [row.seq for row in five.read(after=2, limit=2)] == [3, 4]
    assert [row.seq for row in five.read_newest(before=4, limit=2)] == [3, 2]
    (first,) = five.read(limit=1)
    assert replace(first.entry, at="") == replace(ENTRY, outcome="200")


COLUMNS = "at", "who", "role", "source", "request_id", "what", "outcome"
FORGED = "UPDATE audit SET hash = substr(hash, 2) || substr(hash, 1, 1) WHERE seq = 3"


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        *(
            (f"UPDATE audit SET {column} = 'x' WHERE seq = 3", "row 3 has been changed")
            for column in COLUMNS
        ),
        ("DELETE FROM audit WHERE seq = 3", "row 3 is missing"),
        ("DELETE FROM audit WHERE seq = 1", "row 1 is missing"),
        ("DELETE FROM audit WHERE seq = 5", "row 5 is missing"),
        ("DELETE FROM audit WHERE seq > 3", "rows 4 to 5 are missing"),
        ("DELETE FROM audit WHERE seq > 0", "rows 1 to 5 are missing"),
        (FORGED, "row 3 has been changed; row 4 has been changed"),
    ],
)
def test_a_row_that_was_changed_or_removed_is_named(five, database, statement, said):
    """By somebody who has the file in hand; the next row finds a hash made anew."""
    with database.engine.begin() as connection:
        for verb in ("update", "delete"):
            connection.execute(text(f"DROP TRIGGER audit_no_{verb}"))
        connection.execute(text(statement))
    assert "; ".join(five.verify()) == said


def test_entries_wait_for_the_catalogue_in_order(audit_log, database, writer):
    with locked(database):
        begun = time.monotonic()
        done = [writer.record(replace(ENTRY, outcome=str(n))) for n in range(3)]
        assert time.monotonic() - begun < 0.1
        assert not done[0].done()
    for entry in done:
        entry.result(timeout=10)
    writer.close()
    assert [row.entry.outcome for row in audit_log.read()] == ["0", "1", "2"]
    assert audit_log.verify() == []


def test_what_strangers_repeat_is_counted_in_few_rows(audit_log, writer):
    for _ in range(5000):
        writer.record(STRANGER, may_repeat=True)
    writer.record(ENTRY).result(timeout=10)
    for number in range(1000):
        kind = replace(STRANGER, what=f"POST /api/v1/{number}", outcome="401")
        writer.record(kind, may_repeat=True)
    writer.close()
    rows = [row.entry for row in audit_log.read()]
    of_stops = [one for one in rows if one.outcome == "202" and not one.who]
    assert len(of_stops) < 20
    assert sum((one.new or {"times": 1})["times"] for one in of_stops) == 5000
    (change,) = (one for one in rows if one.who)
    assert replace(change, at="") == ENTRY, "a change stays as it is"
    assert rows.index(of_stops[0]) < rows.index(change)
    assert len(rows) < 20 + 1 + audit.MOST_KINDS + 20
    assert audit_log.verify() == []


def test_what_could_not_be_written_is_counted_at_the_end(database, writer, monkeypatch):
    monkeypatch.setattr(audit, "MOST_WAITING", 3)
    monkeypatch.setattr(audit, "_CLOSE_S", 0.1)
    with locked(database), capture_logs() as logs:
        for _ in range(5):
            writer.record(ENTRY)
        writer.close()
    (said,) = (one for one in logs if "complete" in one["event"])
    assert said["not_written"] == 5


def test_an_unforeseen_error_costs_one_row_alone(audit_log, writer, monkeypatch):
    append = audit_log.append

    def fail_once(entry):
        monkeypatch.setattr(audit_log, "append", append)
        raise ValueError(entry.what)

    monkeypatch.setattr(audit_log, "append", fail_once)
    for outcome in ("1", "2"):
        writer.record(replace(ENTRY, outcome=outcome)).result(timeout=10)
    with capture_logs() as logs:
        writer.close()
    assert [row.entry.outcome for row in audit_log.read()] == ["2"]
    assert logs[-1]["not_written"] == 1
