"""Passwords: argon2id, with the parameters that argon2-cffi recommends (RFC 9106)."""

from __future__ import annotations

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from truepath.errors import BadInput

SHORTEST, LONGEST = 10, 200

_hasher = PasswordHasher()
_NOBODY = (  # a hash of the same cost; to make one takes a third of a second
    "$argon2id$v=19$m=65536,t=3,p=4$7L/cmRntCvkbKmd5KIKS7Q$+fZY/B"
    "fwkQnxlvS9zlKdJncZhKvVBtVvfUh1JBU3RfI"
)


def hash_password(password: str) -> str:
    """Hash of a password. Raises BadInput if it is too short or too long."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise BadInput(
            f"the password has {len(password)} characters; "
            f"choose {SHORTEST} to {LONGEST}"
        )
    return _hasher.hash(password)


def is_password(password: str, kept: str | None) -> bool:
    """Whether it is the password. Without a user it takes just as long."""
    try:
        return _hasher.verify(kept or _NOBODY, password) and kept is not None
    except (VerificationError, InvalidHashError):
        return False
