"""Single-use tokens that permit one motion of a machine.

A token is bound to job, version, user, machine and rows. Only its hash is kept, in
memory: a restart of the service disarms.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
from dataclasses import dataclass

from truepath.catalogue.errors import ArmTokenExpired, ArmTokenOther, ArmTokenUsed
from truepath_drivers import host_clock

VALID_S = 60.0
MAX_TOKENS = 1024  # of all jobs; the oldest are dropped
_BYTES = 24


@dataclass(frozen=True, slots=True)
class ArmingPurpose:
    """Binding of an arm token.

    version : of the job; machine_version : of the machine's configuration
    user : name of the requesting user; None without login
    plan_sha256 : of the rows that are commanded
    """

    job_id: str
    version: int
    user: str | None
    machine_id: str
    machine_version: int
    plan_sha256: str


@dataclass(slots=True)
class _Issued:
    sha256: bytes
    purpose: ArmingPurpose
    expires_s: float
    is_used: bool = False


class ArmTokens:
    """Issued tokens; thread-safe.

    valid_s : lifetime of a token
    """

    def __init__(self, valid_s: float = VALID_S) -> None:
        self.valid_s = valid_s
        self._lock = threading.Lock()
        self._issued: list[_Issued] = []

    def issue(self, purpose: ArmingPurpose) -> str:
        """URL-safe random text, shown once: only its hash is stored."""
        token = secrets.token_urlsafe(_BYTES)
        issued = _Issued(_hash(token), purpose, host_clock.now_s() + self.valid_s)
        with self._lock:
            self._issued = [*self._issued[1 - MAX_TOKENS :], issued]
        return token

    def use(self, token: str, purpose: ArmingPurpose) -> None:
        """Invalidate a token after a match.

        Raises ArmTokenOther, ArmTokenUsed, ArmTokenExpired; the token is then kept.
        """
        with self._lock:
            issued = self._find(token)
            if issued is None:
                raise ArmTokenOther("the service knows no such token")
            if different := _name_difference(issued.purpose, purpose):
                raise ArmTokenOther(f"the token was given for another {different}")
            if issued.is_used:
                raise ArmTokenUsed("the token has let the machine move already")
            if host_clock.now_s() >= issued.expires_s:
                raise ArmTokenExpired(
                    f"the token was good for {self.valid_s:g} s, which have passed"
                )
            issued.is_used = True

    def _find(self, token: str) -> _Issued | None:
        """Compares with every record, in constant time."""
        wanted = _hash(token)
        found = None
        for issued in self._issued:
            if hmac.compare_digest(issued.sha256, wanted):
                found = issued
        return found


def _hash(token: str) -> bytes:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest()


def _name_difference(given: ArmingPurpose, wanted: ArmingPurpose) -> str:
    pairs = (
        ("user", given.user == wanted.user),
        ("machine", given.machine_id == wanted.machine_id),
        ("job", given.job_id == wanted.job_id),
        (
            "configuration of the machine",
            given.machine_version == wanted.machine_version,
        ),
        ("plan", given.plan_sha256 == wanted.plan_sha256),
        ("state of the job", given.version == wanted.version),
    )
    return next((name for name, is_same in pairs if not is_same), "")
