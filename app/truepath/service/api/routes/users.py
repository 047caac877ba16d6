"""The session of a request; users, API keys and the audit log."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Annotated, Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

from truepath.service.api.access_control import (
    COOKIE,
    note_change,
    read_token,
)
from truepath.service.api.guard import find_network, find_source
from truepath.service.api.models.base import BASE, RequestBody, examples
from truepath.service.api.problems import declare_problems
from truepath.service.api.service import AccessDep, ActorDep, ServiceDep, owner_of
from truepath.users.accounts import LONGEST
from truepath.users.audit import encode_row
from truepath.users.roles import Actor, Role

router = APIRouter(tags=["users"])

_LOGGING_IN = CapacityLimiter(4)


class LogIn(RequestBody):
    """Who logs in. A browser asks for a cookie, which scripts cannot read."""

    model_config = examples({"name": "anna", "password": "a long sentence is easy"})

    name: str = Field(max_length=64, examples=["anna"])
    password: str = Field(max_length=200, examples=["a long sentence is easy"])
    cookie: bool = Field(
        False, description="Put the token into a cookie in place of the answer."
    )


class SessionOut(BaseModel):
    """Who sends the request, and what the role allows."""

    log_in_required: bool = Field(
        description="False: whoever reaches the service may do everything."
    )
    name: str | None = Field(examples=["anna"], description="Null: nobody.")
    role: Role | None = Field(examples=["operator"])
    is_person: bool = Field(description="False for an API key.")


class SessionOpened(SessionOut):
    """A new session."""

    token: str | None = Field(
        description="For `Authorization: Bearer`; null where it is in the cookie."
    )
    expires_in_s: float


@router.get("/session")
def get_session(actor: ActorDep, service: ServiceDep) -> SessionOut:
    """Return who sends the request. Nobody is no refusal."""
    return _describe(actor, required=service.access.rules.log_in_required)


@router.post("/session", responses=declare_problems(401, 422, 429))
async def log_in(
    given: LogIn, request: Request, response: Response, access: AccessDep
) -> SessionOpened:
    """Log in with name and password."""
    note_change(request, old={}, new={"name": given.name})
    source = find_network(find_source(request.scope))
    # Not on a thread: guessing one name must not delay log-ins by other names.
    await asyncio.sleep(access.find_delay_s(given.name, source))
    token, actor = await run_sync(
        access.log_in, given.name, given.password, source, limiter=_LOGGING_IN
    )
    request.state.known = actor
    if given.cookie:
        response.set_cookie(
            COOKIE,
            token,
            max_age=int(access.rules.session_s),
            secure=access.rules.secure_cookie,
            httponly=True,
            samesite="strict",
            path=f"{BASE.get()}/",
        )
    shown = _describe(actor, required=access.rules.log_in_required).model_dump()
    return SessionOpened(
        **shown,
        token=None if given.cookie else token,
        expires_in_s=access.rules.session_s,
    )


@router.delete("/session", status_code=204)
def log_out(request: Request, response: Response, access: AccessDep) -> None:
    """End the session at once. Twice is once."""
    token = read_token(request.scope)
    if token:
        access.tokens.end(token)
    path = f"{BASE.get()}/"
    response.delete_cookie(COOKIE, path, httponly=True, samesite="strict")


def _describe(actor: Actor | None, *, required: bool) -> SessionOut:
    return SessionOut(
        log_in_required=required,
        name=owner_of(actor),
        role=actor.role if actor else None,
        is_person=actor is None or actor.is_person,
    )


Name = Annotated[
    str, Path(max_length=64, description="Of the user or key.", examples=["anna"])
]
Password = Annotated[str, Field(max_length=LONGEST)]


class NewUser(RequestBody):
    """A user to add."""

    model_config = examples(
        {
            "name": "anna",
            "role": "operator",
            "password": "a long sentence is easy",
        }
    )

    name: str = Field(max_length=64, examples=["anna"])
    role: Role = Field(examples=["operator"])
    password: Password = Field(examples=["a long sentence is easy"])


class UserChange(RequestBody):
    """What to change of a user; what is left out stays."""

    model_config = examples({"role": "metrologist"})

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

    model_config = examples({"name": "plant-computer", "days": 90})

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
