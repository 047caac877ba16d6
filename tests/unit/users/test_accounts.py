"""Users and their passwords."""

import pytest
from sqlalchemy import text

from truepath.errors import BadInput, NotFound
from truepath.users import passwords
from truepath.users.errors import UserConflict
from truepath.users.passwords import is_password
from truepath.users.roles import Role, includes

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


@pytest.mark.parametrize("name", ["", "-x", "a b", "a\nb", "ä/ö", "x" * 65])
def test_what_is_no_name_is_refused(accounts, name):
    with pytest.raises(BadInput, match="is no name"):
        accounts.add(name, Role.VIEWER, PASSWORD)


@pytest.mark.parametrize(
    ("name", "role", "password", "refused"),
    [
        ("ben", Role.VIEWER, "x" * 9, "9 characters; choose 10"),
        ("anna", Role.VIEWER, PASSWORD, "anna already"),
        ("ben", Role.SERVICE, PASSWORD, "role of programs"),
    ],
)
def test_a_short_password_a_name_that_is_taken_and_a_role_of_programs_are_refused(
    accounts, name, role, password, refused
):
    error = UserConflict if name == "anna" else BadInput
    with pytest.raises(error, match=refused):
        accounts.add(name, role, password)


def test_the_last_administrator_stays(accounts):
    with pytest.raises(UserConflict, match="last administrator"):
        accounts.remove("anna")
    with pytest.raises(UserConflict, match="last administrator"):
        accounts.set_role("anna", Role.VIEWER)
    accounts.add("ben", Role.ADMINISTRATOR, PASSWORD)
    accounts.remove("anna")
    assert [user.name for user in accounts.list_all()] == ["ben"]


@pytest.mark.parametrize(
    "change",
    [
        lambda accounts: accounts.remove("ben"),
        lambda accounts: accounts.set_password("ben", PASSWORD),
        lambda accounts: accounts.set_role("ben", Role.VIEWER),
    ],
)
def test_who_is_not_there_is_not_changed(accounts, change):
    with pytest.raises(NotFound, match="no user ben"):
        change(accounts)


def test_each_role_may_what_those_before_it_may():
    ladder = [Role.VIEWER, Role.OPERATOR, Role.METROLOGIST, Role.ADMINISTRATOR]
    for i, role in enumerate(ladder):
        assert [includes(role, least) for least in ladder] == [
            j <= i for j in range(len(ladder))
        ]
    assert includes(Role.SERVICE, Role.OPERATOR)
    assert not includes(Role.SERVICE, Role.METROLOGIST)
