"""Roles, and which of them include another."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Role(StrEnum):
    """What somebody may do. `SERVICE` is a program: what an operator may."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    METROLOGIST = "metrologist"
    ADMINISTRATOR = "administrator"
    SERVICE = "service"


PERSONAL_ROLES = tuple(role for role in Role if role is not Role.SERVICE)
KEY_ROLES = (Role.VIEWER, Role.SERVICE, Role.METROLOGIST)
"""Of API keys: no program administers users."""

_RANK = {
    Role.VIEWER: 0,
    Role.OPERATOR: 1,
    Role.SERVICE: 1,
    Role.METROLOGIST: 2,
    Role.ADMINISTRATOR: 3,
}


def includes(role: Role, least: Role) -> bool:
    """Whether a role may do all that the least one may."""
    return _RANK[role] >= _RANK[least]


@dataclass(frozen=True, slots=True)
class Actor:
    """Sender of a request.

    name : of the user or of the API key; empty where there is no login
    is_person : a session of a user, or a person at this computer
    """

    name: str
    role: Role
    is_person: bool = True


LOCAL = Actor("", Role.ADMINISTRATOR)
"""Any client of a service without login."""
