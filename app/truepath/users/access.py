"""Sender of a request, whether it is allowed, and waits after failed log-ins."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass

from truepath.catalogue.database import Database
from truepath.users.accounts import Accounts, is_password
from truepath.users.audit import AuditLog, AuditWriter
from truepath.users.errors import (
    NotLoggedIn,
    PersonNeeded,
    RoleTooLow,
    TooManyRequests,
    TooManyTries,
    WrongPassword,
)
from truepath.users.roles import LOCAL, Actor, Role, includes
from truepath.users.tokens import Tokens
from truepath_drivers import host_clock

FREE_TRIES = 5
FREE_TRIES_OF_SOURCE = 20
LONGEST_DELAY_S = 2.0
"""Of a name that fails from any source: it slows guessing, and locks nobody out."""
LONGEST_WAIT_S = 900.0
FORGET_S = 3600.0
"""After so long without a failure earlier ones no longer count."""
_REMEMBERED = 10_000
_BURST, _CHANGES_PER_S = 200, 20.0


@dataclass(frozen=True, slots=True)
class AccessRules:
    """How access is set up.

    log_in_required : else any client may do everything
    arming_by_key : whether a program may set the machine in motion
    session_s : how long a session lasts
    secure_cookie : whether the cookie of a session goes over TLS only
    """

    log_in_required: bool = False
    arming_by_key: bool = False
    session_s: float = 12 * 3600.0
    secure_cookie: bool = True


class Access:
    """Users, tokens and audit log of one catalogue behind the routes."""

    def __init__(self, database: Database, rules: AccessRules) -> None:
        self.rules = rules
        self.accounts = Accounts(database)
        self.tokens = Tokens(database, session_s=rules.session_s)
        self.audit_log = AuditLog(database)
        self.audit_writer = AuditWriter(self.audit_log)
        self._failed = BackOff(FREE_TRIES)
        self._failed_of_source = BackOff(FREE_TRIES_OF_SOURCE)
        self._failed_of_name = BackOff(FREE_TRIES, longest_s=LONGEST_DELAY_S)
        self._changes = RateLimit(_BURST, _CHANGES_PER_S)
        # One hash takes 64 MB and a core for 30 ms: not many at one time.
        self._hashing = threading.Semaphore(2)

    def identify(self, token: str) -> Actor | None:
        """Owner of a token; None if it is unknown or has expired."""
        if not self.rules.log_in_required:
            return LOCAL
        return self.tokens.find(token) if token else None

    def find_delay_s(self, name: str, source: str) -> float:
        """Delay of a log-in, s. Raises TooManyTries."""
        self._check(name, source)
        return self._failed_of_name.find_wait_s(name)

    def log_in(self, name: str, password: str, source: str) -> tuple[str, Actor]:
        """Token of a new session, and its owner.

        Raises WrongPassword; TooManyTries, before the password is checked, while name
        or source have to wait.
        """
        own = self._check(name, source)
        found = self.accounts.find(name)
        if not self._hashing.acquire(timeout=5.0):
            raise TooManyTries("too many log-ins at one time", 5.0)
        try:
            is_right = is_password(password, found[1] if found else None)
        finally:
            self._hashing.release()
        if found is None or not is_right:
            self._failed.fail(own)
            self._failed_of_source.fail(source)
            self._failed_of_name.fail(name)
            raise WrongPassword("name and password do not belong together")
        self._failed.clear(own)
        user = found[0]
        return self.tokens.open_session(user.name), Actor(user.name, user.role)

    def _check(self, name: str, source: str) -> str:
        # By name and source: another person's mistakes lock nobody out.
        own = f"{name}@{source}"
        self._failed.check(own)
        self._failed_of_source.check(source)
        return own

    def limit_changes(self, actor: Actor) -> None:
        """Raise TooManyRequests if an actor changes too much in a short time."""
        if self.rules.log_in_required:
            self._changes.count_request(actor.name)

    def close(self) -> None:
        """Write the waiting entries of the audit log."""
        self.audit_writer.close()


def require_role(actor: Actor | None, least: Role) -> Actor:
    """The actor itself. Raises NotLoggedIn, RoleTooLow."""
    if actor is None:
        raise NotLoggedIn("no valid session or API key came with the request")
    if not includes(actor.role, least):
        raise RoleTooLow(f"this needs the role {least}; {actor.name} is {actor.role}")
    return actor


def require_person(actor: Actor, rules: AccessRules) -> None:
    """Raise PersonNeeded for the API key of a program, unless that is allowed."""
    if not (actor.is_person or rules.arming_by_key):
        raise PersonNeeded(
            f"{actor.name} is an API key; the machine is set in motion by a person"
        )


@dataclass(frozen=True, slots=True)
class _Failures:
    count: int = 0
    last_s: float = 0.0
    until_s: float = 0.0


class BackOff:
    """Counts failures of each key, and makes a key wait longer after each further one.

    free : failures before the first wait of 1 s, which then doubles to the longest
    """

    def __init__(self, free: int, *, longest_s: float = LONGEST_WAIT_S) -> None:
        self._free, self._longest_s = free, longest_s
        self._lock = threading.Lock()
        self._failed: OrderedDict[str, _Failures] = OrderedDict()

    def check(self, key: str) -> None:
        """Raise TooManyTries while the key has to wait."""
        left_s = self.find_wait_s(key)
        if left_s > 0:
            raise TooManyTries(
                f"too many log-ins have failed; try again in {left_s:.0f} s", left_s
            )

    def find_wait_s(self, key: str) -> float:
        """Remaining wait of the key, s."""
        with self._lock:
            failures = self._failed.get(key, _Failures())
        return max(0.0, failures.until_s - host_clock.now_s())

    def fail(self, key: str) -> None:
        """Count a failure."""
        now_s = host_clock.now_s()
        with self._lock:
            before = self._failed.pop(key, _Failures())
            is_forgotten = now_s - before.last_s >= FORGET_S
            count = 1 if is_forgotten else before.count + 1
            over = count - self._free
            wait_s = min(2.0 ** min(over, 20), self._longest_s) if over >= 0 else 0.0
            self._failed[key] = _Failures(count, now_s, now_s + wait_s)
            if len(self._failed) > _REMEMBERED:
                self._failed.popitem(last=False)

    def clear(self, key: str) -> None:
        """Reset a key after a success."""
        with self._lock:
            self._failed.pop(key, None)


class RateLimit:
    """Limits requests per key: a burst, then a rate per second."""

    def __init__(self, burst: int, per_second: float) -> None:
        self._burst, self._per_second = burst, per_second
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def count_request(self, key: str) -> None:
        """Count one request. Raises TooManyRequests beyond the limit."""
        now = host_clock.now_s()
        with self._lock:
            left, since_s = self._left.pop(key, (float(self._burst), now))
            left = min(left + (now - since_s) * self._per_second, float(self._burst))
            self._left[key] = (left - 1.0 if left >= 1.0 else left), now
            if len(self._left) > _REMEMBERED:
                self._left.popitem(last=False)
        if left < 1.0:
            wait_s = (1.0 - left) / self._per_second
            raise TooManyRequests("too many requests in a short time", wait_s)
