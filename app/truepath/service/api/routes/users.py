"""Users, API keys and the audit log, for administrators."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from pydantic import BaseModel, ConfigDict, Field

from truepath.service.api.models.base import RequestBody
from truepath.service.api.problems import declare_problems
from truepath.service.api.security.access_control import note_change
from truepath.service.api.security.session import AccessDep
from truepath.users.audit import encode_row
from truepath.users.passwords import LONGEST
from truepath.users.roles import Role

router = APIRouter(tags=["users"])

Name = Annotated[
    str, Path(max_length=64, description="Of the user or key.", examples=["anna"])
]
Password = Annotated[str, Field(max_length=LONGEST)]


class NewUser(RequestBody):
    """A user to add."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "name": "anna",
                    "role": "operator",
                    "password": "a long sentence is easy",
                }
            ]
        },
    )

    name: str = Field(max_length=64, examples=["anna"])
    role: Role = Field(examples=["operator"])
    password: Password = Field(examples=["a long sentence is easy"])


class UserChange(RequestBody):
    """What to change of a user; what is left out stays."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"role": "metrologist"}]},
    )

    role: Role | None = None
    password: Password | None = None


class UserOut(BaseModel):
    """A person who may log in."""

    name: str = Field(examples=["anna"])
    role: Role = Field(examples=["operator"])
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])


class UserList(BaseModel):
    """All users, by name."""

    items: list[UserOut]


class NewKey(RequestBody):
    """An API key to make."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"name": "plant-computer", "days": 90}]},
    )

    name: str = Field(max_length=64, examples=["plant-computer"])
    role: Role = Field(Role.SERVICE, examples=["service"])
    days: float | None = Field(
        None, gt=0, le=3650, allow_inf_nan=False, description="Null: until revoked."
    )


class KeyOut(BaseModel):
    """An API key, without its token."""

    name: str = Field(examples=["plant-computer"])
    role: Role = Field(examples=["service"])
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    expires_in_s: float | None


class KeyList(BaseModel):
    """All API keys, by name."""

    items: list[KeyOut]


class KeyMade(BaseModel):
    """A new API key; its token is shown this once."""

    name: str = Field(examples=["plant-computer"])
    token: str = Field(description="For `Authorization: Bearer`.")


Change = dict[str, str | float | bool | list[str] | None] | None


class AuditEntry(BaseModel):
    """One row of the audit log."""

    seq: int
    at: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    who: str = Field(examples=["anna"], description="Empty where nobody is known.")
    role: str = Field(examples=["operator"])
    source: str = Field(examples=["192.0.2.17"])
    request_id: str
    what: str = Field(examples=["POST /api/v1/jobs"])
    outcome: str = Field(examples=["202"], description="Status of the answer.")
    old: Change = Field(description="What was; a password or token never.")
    new: Change = Field(description="What is.")
    hash: str = Field(description="SHA-256 over this row and the hash of the last.")


class AuditPage(BaseModel):
    """Rows of the audit log, the newest first."""

    items: list[AuditEntry]
    next: int | None = Field(description="`before` of the next page.")


@router.get("/users")
def list_users(access: AccessDep) -> UserList:
    """List the users."""
    found = access.accounts.list_all()
    return UserList(items=[UserOut(**asdict(user)) for user in found])


@router.post("/users", status_code=201, responses=declare_problems(409, 422))
def add_user(given: NewUser, request: Request, access: AccessDep) -> UserOut:
    """Add a user."""
    note_change(request, old={}, new={"name": given.name, "role": given.role})
    return UserOut(
        **asdict(access.accounts.add(given.name, given.role, given.password))
    )


@router.patch("/users/{name}", responses=declare_problems(404, 409, 422))
def change_user(
    name: Name, given: UserChange, request: Request, access: AccessDep
) -> UserList:
    """Change role or password of a user; the role counts at once."""
    old: dict[str, Any] = {}
    new: dict[str, Any] = {}
    if given.role is not None:
        old["role"] = access.accounts.set_role(name, given.role)
        new["role"] = given.role
    if given.password is not None:
        access.accounts.set_password(name, given.password)
        new["password"] = "changed"  # noqa: S105 (that it was)
    note_change(request, old=old, new=new)
    return list_users(access)


@router.delete(
    "/users/{name}", status_code=204, responses=declare_problems(404, 409, 422)
)
def remove_user(name: Name, request: Request, access: AccessDep) -> None:
    """Remove a user and end all sessions."""
    note_change(request, old={"role": access.accounts.remove(name)}, new={})


@router.get("/keys")
def list_keys(access: AccessDep) -> KeyList:
    """List the API keys."""
    return KeyList(items=[KeyOut(**asdict(key)) for key in access.tokens.list_keys()])


@router.post("/keys", status_code=201, responses=declare_problems(409, 422))
def create_key(given: NewKey, request: Request, access: AccessDep) -> KeyMade:
    """Make an API key."""
    note_change(request, old={}, new={"name": given.name, "role": given.role})
    token = access.tokens.create_key(given.name, given.role, given.days)
    return KeyMade(name=given.name, token=token)


@router.delete("/keys/{name}", status_code=204, responses=declare_problems(404, 422))
def revoke_key(name: Name, access: AccessDep) -> None:
    """Revoke an API key at once."""
    access.tokens.revoke_key(name)


@router.get("/audit", responses=declare_problems(422))
def read_audit(
    access: AccessDep,
    limit: Annotated[int, Query(ge=1, le=200, description="Rows on a page.")] = 50,
    before: Annotated[
        int | None,
        Query(
            ge=1, le=2**62, description="`next` of the page before: only older rows."
        ),
    ] = None,
) -> AuditPage:
    """Read the audit log, the newest rows first."""
    rows = access.audit_log.read_newest(before=before, limit=limit)
    items = [AuditEntry(**encode_row(row)) for row in rows]
    return AuditPage(items=items, next=rows[-1].seq if len(rows) == limit else None)
