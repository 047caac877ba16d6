"""The audit log: only added to; what was changed or taken out is named."""

import time
from contextlib import contextmanager
from dataclasses import replace

import pytest
from sqlalchemy import text
from structlog.testing import capture_logs

from truepath.users import audit

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
