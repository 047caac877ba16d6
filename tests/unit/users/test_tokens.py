"""Sessions and API keys: opaque, revoked at once, not moved by clock jumps."""

import pytest
from sqlalchemy import text

from truepath.errors import BadInput, NotFound
from truepath.users.boot_clock import read_moment
from truepath.users.errors import UserConflict
from truepath.users.roles import Actor, Role

PASSWORD = "a long sentence is easy"


@pytest.fixture
def session(accounts, tokens):
    return tokens.open_session("anna")


def test_a_session_is_that_of_its_user_and_its_token_is_kept_as_a_hash_only(
    database, tokens, session
):
    assert tokens.find(session) == Actor("anna", Role.ADMINISTRATOR)
    assert tokens.find(session + "x") is None
    assert tokens.find("") is None
    with database.read() as connection:
        rows = connection.execute(text("SELECT * FROM tokens")).all()
    assert len(rows) == 1
    assert session not in str(rows)


@pytest.mark.fault_row(29)
@pytest.mark.parametrize("jump_s", [0, 3 * 3600, -3 * 3600, -1e9])
def test_a_jump_of_the_wall_clock_neither_ends_nor_lengthens_a_session(
    tokens, session, clock, jump_s
):
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


def test_another_role_and_a_log_out_count_at_once(accounts, tokens, session):
    accounts.add("ben", Role.ADMINISTRATOR, PASSWORD)
    accounts.set_role("anna", Role.VIEWER)
    assert tokens.find(session) == Actor("anna", Role.VIEWER)
    for _ in range(2):  # twice is once
        tokens.end(session)
        assert tokens.find(session) is None


def test_another_password_ends_all_sessions_and_leaves_keys(accounts, tokens, session):
    key = tokens.create_key("plant", Role.SERVICE)
    accounts.set_password("anna", "quite another sentence")
    assert tokens.find(session) is None
    assert tokens.find(key)


def test_who_is_removed_has_no_session(accounts, tokens):
    accounts.add("ben", Role.VIEWER, PASSWORD)
    session = tokens.open_session("ben")
    accounts.remove("ben")
    accounts.add("ben", Role.OPERATOR, PASSWORD)
    assert tokens.find(session) is None


def test_sessions_that_have_ended_are_forgotten(database, tokens, session, clock):
    clock.pass_s(3601)
    tokens.open_session("anna")
    with database.read() as connection:
        assert connection.execute(text("SELECT count(*) FROM tokens")).scalar() == 1


def test_a_key_is_no_person_and_lasts_until_it_is_revoked(tokens, clock):
    key = tokens.create_key("plant", Role.SERVICE)
    clock.pass_s(1e8)
    assert tokens.find(key) == Actor("plant", Role.SERVICE, is_person=False)
    tokens.revoke_key("plant")
    assert tokens.find(key) is None
    with pytest.raises(NotFound, match="no API key plant"):
        tokens.revoke_key("plant")


def test_a_key_can_have_an_end(tokens, clock):
    key = tokens.create_key("plant", Role.SERVICE, days=2)
    clock.pass_s(86400)
    (listed,) = tokens.list_keys()
    assert listed.expires_in_s == pytest.approx(86400)
    clock.pass_s(86401)
    assert tokens.find(key) is None


def test_no_key_has_the_role_or_the_name_of_a_person(accounts, tokens):
    for role in (Role.ADMINISTRATOR, Role.OPERATOR):
        with pytest.raises(BadInput, match="an API key is one of"):
            tokens.create_key("plant", role)
    with pytest.raises(UserConflict):
        tokens.create_key("anna", Role.SERVICE)


def test_the_computer_knows_when_it_was_started():
    first, then = read_moment(), read_moment()
    assert first.boot_id == then.boot_id != ""
    assert 0 <= first.age_s(then) < 10
