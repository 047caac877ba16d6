"""The session of a request: log in, log out, present user."""

from __future__ import annotations

import asyncio
from typing import Annotated

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from truepath.service.api.models.base import BASE, RequestBody
from truepath.service.api.problems import declare_problems
from truepath.service.api.security.access_control import COOKIE, note_change, read_token
from truepath.service.api.security.trusted_proxies import find_network, find_source
from truepath.service.api.service import ServiceDep
from truepath.users.access import Access
from truepath.users.roles import Actor, Role

router = APIRouter(prefix="/session", tags=["users"])

_LOGGING_IN = CapacityLimiter(4)


class LogIn(RequestBody):
    """Who logs in. A browser asks for a cookie, which scripts cannot read."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [{"name": "anna", "password": "a long sentence is easy"}]
        },
    )

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


async def _actor(request: Request) -> Actor | None:
    return request.state.actor


ActorDep = Annotated[Actor | None, Depends(_actor)]
"""Sender of the request; None where unknown."""


async def _access(service: ServiceDep) -> Access:
    return service.access


AccessDep = Annotated[Access, Depends(_access)]


def owner_of(actor: Actor | None) -> str | None:
    """Owner of a job; None without login."""
    return actor.name or None if actor else None


@router.get("")
def get_session(actor: ActorDep, service: ServiceDep) -> SessionOut:
    """Return who sends the request. Nobody is no refusal."""
    return _describe(actor, required=service.access.rules.log_in_required)


@router.post("", responses=declare_problems(401, 422, 429))
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


@router.delete("", status_code=204)
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
