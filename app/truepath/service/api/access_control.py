"""Authentication of a request, check of its role, and its audit log.

Plain ASGI, before the routes: nothing of a request is read, and no stream opens, before
its sender is known.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from typing import Any, Protocol

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from starlette.datastructures import Headers, State
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from truepath.catalogue.errors import StorageUnavailable
from truepath.errors import TruepathError
from truepath.jobs.dispatch.deletion import Deleted
from truepath.service.api.guard import find_peer, find_source
from truepath.service.api.models.base import PREFIX
from truepath.service.api.problems import make_error_response
from truepath.service.api.route_roles import (
    ABORT,
    ANYBODY,
    CHECKS,
    FREE_TO_STOP,
    HOLDS,
    MOVES,
    NEVER_LIMITED,
    find_least_role,
    find_route,
)
from truepath.users.access import Access, require_person, require_role
from truepath.users.audit import Entry
from truepath.users.roles import LOCAL, Actor, Role

COOKIE = "truepath_session"
AUDIT_PATIENCE_S = 1.0
"""Longest wait of an answer for its row of the audit log."""

# Apart from all other work: whose abort it is waits for no bundle and no log-in.
_IDENTIFYING, _IDENTIFYING_TO_STOP = CapacityLimiter(8), CapacityLimiter(8)
_READS = frozenset({"GET", "HEAD", "OPTIONS"})
_NOT_LOGGED_IN = 401
_REFUSED = 400


class AccessControl:
    """Lets a request through to the routes with its `actor`, or refuses it.

    access : None only to describe the interface
    """

    def __init__(self, app: ASGIApp, access: Access | None) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        state["actor"] = LOCAL
        access = self._access
        if access is None:
            await self._app(scope, receive, send)
            return
        method = scope.get("method", "GET")
        route = find_route(method, scope["path"])
        audited = _AuditedAnswer(access, scope, send, route)
        try:
            state["actor"] = await _authorise(access, scope, method, route)
        except TruepathError as error:
            state["actor"] = None
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                await make_error_response(error, scope)(scope, receive, audited.send)
            return
        await self._app(scope, receive, audited.send if method not in _READS else send)


async def _authorise(
    access: Access, scope: Scope, method: str, route: str
) -> Actor | None:
    least = find_least_role(method, route)
    is_open = least is ANYBODY
    if is_open and (route in FREE_TO_STOP or not scope["path"].startswith(PREFIX)):
        return None
    try:
        limiter = _IDENTIFYING_TO_STOP if route in HOLDS else _IDENTIFYING
        actor = await run_sync(access.identify, read_token(scope), limiter=limiter)
    except StorageUnavailable:
        if route == ABORT:  # not refused because of a disk
            return None
        raise
    scope["state"]["known"] = actor
    if is_open:
        return actor
    actor = require_role(actor, least or Role.ADMINISTRATOR)
    if route in MOVES:
        require_person(actor, access.rules)
    if method not in _READS and route not in NEVER_LIMITED:
        access.limit_changes(actor)
    return actor


def read_token(scope: Scope) -> str:
    """Token from the header of a request, or from its cookie; else empty."""
    headers = Headers(scope=scope)
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    with suppress(CookieError):
        morsel = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        return morsel.value if morsel else ""
    return ""


def note_change(
    request: HTTPConnection, *, old: Mapping[str, Any], new: Mapping[str, Any]
) -> None:
    """Set the values before and after a change for the audit log."""
    state: State = request.state
    state.old, state.new = old, new


def note_deletion(request: HTTPConnection, deleted: Sequence[Deleted]) -> None:
    """Set the deleted files and their digests for the audit log."""
    old = {name: sha256 for one in deleted for name, sha256 in one.files.items()}
    note_change(request, old=old, new={})


class _Named(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def note(self) -> str | None: ...


def note_naming(request: HTTPConnection, before: _Named, after: _Named) -> None:
    """Set the changed names and notes for the audit log."""
    old, new = ({"name": one.name, "note": one.note or ""} for one in (before, after))
    changed = {key for key in old if old[key] != new[key]}
    note_change(
        request,
        old={key: old[key] for key in changed},
        new={key: new[key] for key in changed},
    )


class _AuditedAnswer:
    """Sends an answer once the audit log has its row; after a second in any case."""

    def __init__(self, access: Access, scope: Scope, send: Send, route: str) -> None:
        self._access, self._scope, self._send = access, scope, send
        self._route = route

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            await self._record(message)
        await self._send(message)

    async def _record(self, message: Message) -> None:
        status = message["status"]
        is_read = self._scope["method"] in _READS
        if self._route in CHECKS or (is_read and status == _NOT_LOGGED_IN):
            return  # a page, or one whose session has ended, asks again and again
        entry = self._make_entry(message)
        may_repeat = not entry.who or status >= _REFUSED or self._route in NEVER_LIMITED
        done = self._access.audit_writer.record(entry, may_repeat=may_repeat)
        if self._route not in NEVER_LIMITED:
            with suppress(TimeoutError):
                waiting = asyncio.shield(asyncio.wrap_future(done))
                await asyncio.wait_for(waiting, AUDIT_PATIENCE_S)

    def _make_entry(self, message: Message) -> Entry:
        scope, state = self._scope, self._scope["state"]
        actor: Actor | None = state.get("known") or state.get("actor")
        sent, answered = Headers(scope=scope), Headers(raw=message["headers"])
        old = state.get("old") or _drop_missing(version=sent.get("if-match"))
        new = state.get("new") or _drop_missing(
            version=answered.get("etag"), made=answered.get("location")
        )
        return Entry(
            who=actor.name if actor else "",
            role=actor.role if actor else "",
            source=_describe_source(scope),
            request_id=state.get("request_id", ""),
            what=f"{scope['method']} {scope['path']}"[:400],
            outcome=str(message["status"]),
            old=old,
            new=new,
        )


def _describe_source(scope: Scope) -> str:
    source, peer = find_source(scope), find_peer(scope)
    return (source if peer == source else f"{source} via {peer}")[:64]


def _drop_missing(**found: str | None) -> dict[str, str] | None:
    return {name: value for name, value in found.items() if value} or None
