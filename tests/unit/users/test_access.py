"""Log-ins that fail, and too many changes in a short time."""

import pytest

from truepath.users.access import FREE_TRIES, Access, AccessRules
from truepath.users.back_off import FORGET_S, LONGEST_WAIT_S, BackOff, RateLimit
from truepath.users.errors import TooManyRequests, TooManyTries, WrongPassword
from truepath.users.roles import LOCAL, Actor, Role

PASSWORD = "a long sentence is easy"


@pytest.fixture
def access(database, accounts):
    access = Access(database, AccessRules(log_in_required=True))
    yield access
    access.close()


def test_who_logs_in_is_known_by_the_token(access):
    token, actor = access.log_in("anna", PASSWORD, "192.0.2.17")
    assert actor == access.identify(token) == Actor("anna", Role.ADMINISTRATOR)


@pytest.mark.parametrize("name", ["anna", "nobody"])
def test_a_refused_log_in_does_not_say_what_was_wrong(access, name):
    with pytest.raises(WrongPassword, match=r"^name and password do not belong"):
        access.log_in(name, "wrong", "192.0.2.17")


def test_after_some_failures_even_the_right_password_waits(access, monkeypatch):
    monkeypatch.setattr("truepath.users.access.is_password", lambda *_: False)
    for _ in range(FREE_TRIES):
        with pytest.raises(WrongPassword):
            access.log_in("anna", "wrong", "192.0.2.17")
    monkeypatch.undo()
    with pytest.raises(TooManyTries, match="try again in 1 s") as refused:
        access.log_in("anna", PASSWORD, "192.0.2.17")
    assert 0 < refused.value.retry_after_s <= 1
    assert access.log_in("anna", PASSWORD, "192.0.2.18"), "another place is not kept"


def test_each_further_failure_waits_twice_as_long_up_to_a_limit(hand_clock):
    back_off = BackOff(3)
    waits = []
    for _ in range(16):
        back_off.fail("anna")
        try:
            back_off.check("anna")
        except TooManyTries as error:
            waits.append(error.retry_after_s)
            hand_clock.time_s += error.retry_after_s
            back_off.check("anna")
    assert waits[:4] == [1, 2, 4, 8]
    assert waits[-1] == LONGEST_WAIT_S
    back_off.forget("anna")
    back_off.fail("anna")
    back_off.check("anna")


def test_a_typo_a_day_never_makes_anybody_wait(hand_clock):
    back_off = BackOff(3)
    for _ in range(31):
        back_off.fail("anna")
        back_off.check("anna")
        hand_clock.time_s += 24 * 3600
    for _ in range(3):
        back_off.fail("anna")
        hand_clock.time_s += FORGET_S - 1
    back_off.fail("anna")
    with pytest.raises(TooManyTries):
        back_off.check("anna")


def test_a_rate_is_a_burst_and_then_so_many_a_second(hand_clock):
    limit = RateLimit(3, 2.0)
    for _ in range(3):
        limit.take("anna")
    with pytest.raises(TooManyRequests) as refused:
        limit.take("anna")
    limit.take("ben")
    assert refused.value.retry_after_s == pytest.approx(0.5)
    hand_clock.time_s += 0.5
    limit.take("anna")
    with pytest.raises(TooManyRequests):
        limit.take("anna")


def test_without_log_in_whoever_comes_may_everything(database):
    access = Access(database, AccessRules())
    assert access.identify("") == access.identify("anything") == LOCAL
    access.close()
