"""Passwords: argon2id, with the parameters that argon2-cffi recommends (RFC 9106)."""

from __future__ import annotations

from functools import cache

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from truepath.errors import BadInput

SHORTEST, LONGEST = 10, 200

_hasher = PasswordHasher()


def hash_password(password: str) -> str:
    """Return what is kept of a password. Raises BadInput if it is too short."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise BadInput(
            f"the password has {len(password)} characters; "
            f"choose {SHORTEST} to {LONGEST}"
        )
    return _hasher.hash(password)


def is_password(password: str, kept: str | None) -> bool:
    """Say whether it is the password. Without a user it takes just as long."""
    try:
        return _hasher.verify(kept or _hash_nobody(), password) and kept is not None
    except (VerificationError, InvalidHashError):
        return False


@cache
def _hash_nobody() -> str:  # at first need: it takes a third of a second
    return _hasher.hash("the password of nobody")
