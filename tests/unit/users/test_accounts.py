"""Users, their log-ins, sessions and API keys: revoked at once, not moved by clocks."""

import pytest
from sqlalchemy import text

from truepath.errors import BadInput, NotFound
from truepath.users import access as limits
from truepath.users import accounts as passwords
from truepath.users import errors
from truepath.users.accounts import is_password
from truepath.users.roles import Actor, Role, includes
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
