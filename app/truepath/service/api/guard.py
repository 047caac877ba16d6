"""Outermost checks: proxies, host names, origins, identifiers, headers, defects.

Plain ASGI, so that streams pass through untouched. Browsers cannot be used against the
service: a page of another site cannot post to it (Sec-Fetch-Site, Origin), and a name
that an attacker points at this computer is not answered (Host). Forwarded headers are
read of the proxies in the settings alone.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
from collections.abc import Collection, Iterable
from contextlib import suppress
from functools import lru_cache
from urllib.parse import urlsplit

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from truepath.service.api.models.base import BASE, PREFIX
from truepath.service.api.problems import (
    BY_STATUS,
    INTERNAL,
    ProblemKind,
    find_kind_of_status,
    make_problem_response,
    problem,
)
from truepath.service.api.route_roles import LONG_LIVED, find_route
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

# plotly.js builds its workers from blobs and styles from script; it needs no eval.
_CONTENT_SECURITY_POLICY = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
"""Of every answer, unless its route has set them otherwise."""

_ONLY_TLS = "max-age=31536000"
_UNSAFE = frozenset({"POST", "PUT", "PATCH", "DELETE"})
_STOP = re.compile(
    rf"({PREFIX}/(?:stop(?::check)?|machines/[^/\0]+/stop(?::check)?|jobs/[^/\0]+/abort))/?$"
)
_OPEN_STOP = re.compile(rf"({PREFIX}/stop)/?$")
_REQUEST_ID = re.compile(r"^[\w.-]{1,64}$")
ROOT_PATH = re.compile(r"(/[\w.~-]+)+", re.ASCII)
_FOR = "x-forwarded-for"
_SCHEMES = {"http": "ws", "https": "wss"}


class Guard:
    """The outermost middleware of the application.

    trusted_hosts : names of this computer besides localhost and any IP address
    """

    def __init__(self, app: ASGIApp, trusted_hosts: Collection[str] = ()) -> None:
        self._app = app
        self._trusted = frozenset({"localhost", *(n.lower() for n in trusted_hosts)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through, or refuse it."""
        if scope["type"] == "websocket":
            await self._open_socket(scope, receive, send)
            return
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = Headers(scope=scope).get("x-request-id", "")
        if not _REQUEST_ID.match(request_id):
            request_id = secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id
        answer = _Answer(scope, send, request_id)
        with structlog.contextvars.bound_contextvars(request_id=request_id):
            try:
                await self._check_request(scope, receive, answer)
            except Exception:
                log.exception("request failed", path=scope["path"])
                await answer.refuse(INTERNAL)
            answer.log()

    async def _open_socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """For pages of this service and programs only: a browser lets every page open a
        WebSocket to any address; only the origin shows which page it was. Stops are
        accepted from everybody.
        """
        headers = Headers(scope=scope)
        is_ours = self._is_own_name(headers.get("host", "")) and _is_same_site(headers)
        if _find_stop(scope, _OPEN_STOP) or is_ours:
            await self._app(scope, receive, send)
            return
        log.info("socket refused", path=scope["path"], origin=headers.get("origin"))
        await send({"type": "websocket.close", "code": 1008})

    async def _check_request(
        self, scope: Scope, receive: Receive, answer: _Answer
    ) -> None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if scope["method"] == "POST" and _find_stop(scope, _STOP):
            # It can only hold: any sender, by any host name, with any body.
            await self._app(scope, _drop_body(scope, receive), answer.send)
        elif not self._is_own_name(host):
            detail = f"{host!r} is not a name of this service"
            await answer.refuse(BY_STATUS[421], detail)
        elif _is_guarded(scope) and not _is_same_site(headers):
            await answer.refuse(BY_STATUS[403])
        elif "\0" in scope["path"]:  # PostgreSQL takes it for no text
            detail = "the address holds the character NUL; no identifier has it"
            await answer.refuse(BY_STATUS[400], detail)
        else:
            await self._app(scope, receive, answer.send)

    def _is_own_name(self, host: str) -> bool:
        """An unknown name may be one that an attacker points at this computer."""
        with suppress(ValueError):  # no host, or no address
            name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
            return name in self._trusted or bool(ipaddress.ip_address(name))
        return False


class _Answer:
    """A refusal in plain text, as the framework writes some, becomes a problem."""

    def __init__(self, scope: Scope, send: Send, request_id: str) -> None:
        self._scope, self._send, self._request_id = scope, send, request_id
        self._begun = host_clock.now_s()
        self._status = 0
        self._is_bare = False

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            is_plain = headers.get("content-type", "").startswith("text/plain")
            self._status = message["status"]
            self._is_bare = is_plain and self._status >= 400
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
            if self._scope.get("scheme") == "https":
                headers["Strict-Transport-Security"] = _ONLY_TLS
            headers["X-Request-ID"] = self._request_id
        if not self._is_bare:
            await self._send(message)
        elif not message.get("more_body", False) and "body" in message:
            self._is_bare = False
            await self._send_problem(find_kind_of_status(self._status))

    async def refuse(self, kind: ProblemKind, detail: str = "") -> None:
        if not self._status:
            await self._send_problem(kind, detail)

    async def _send_problem(self, kind: ProblemKind, detail: str = "") -> None:
        response = make_problem_response(problem(kind, detail), self._scope)
        await response(self._scope, _receive_disconnect, self.send)

    def log(self) -> None:
        is_check = self._scope["path"].endswith(":check")
        is_safe = is_check or self._scope["method"] not in _UNSAFE
        is_quiet = is_safe and self._status < 400
        (log.debug if is_quiet else log.info)(
            "request",
            method=self._scope["method"],
            path=self._scope["path"],
            status=self._status,
            source=find_source(self._scope),
            peer=find_peer(self._scope),
            ms=round(1000 * (host_clock.now_s() - self._begun), 1),
        )


def _find_stop(scope: Scope, pattern: re.Pattern[str]) -> bool:
    """The address is then normalised: a proxy may have added a prefix, or a final or
    double slash.
    """
    found = pattern.search(re.sub("/{2,}", "/", scope["path"]))
    if found:
        scope["path"] = found[1]
    return found is not None


def _drop_body(scope: Scope, receive: Receive) -> Receive:
    of_body = (b"content-length", b"content-type", b"transfer-encoding")
    scope["headers"] = [pair for pair in scope["headers"] if pair[0] not in of_body]
    empty: Message = {"type": "http.request", "body": b"", "more_body": False}
    messages = iter([empty])

    async def receive_none() -> Message:
        return next(messages, None) or await receive()

    return receive_none


def _is_guarded(scope: Scope) -> bool:
    method = scope["method"]
    return method in _UNSAFE or find_route(method, scope["path"]) in LONG_LIVED


async def _receive_disconnect() -> Message:
    return {"type": "http.disconnect"}


def _is_same_site(headers: Headers) -> bool:
    """Programs send neither header."""
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site in ("same-origin", "none")
    origin = headers.get("origin")
    return origin is None or urlsplit(origin).netloc == headers.get("host")


def is_trusted_proxy(host: str, networks: Iterable[str]) -> bool:
    """Whether an address is in one of the networks of the setting."""
    address = _read_address(host)
    return address is not None and any(
        address in ipaddress.ip_network(one) for one in networks
    )


def find_source(scope: Scope) -> str:
    """Address of the client behind trusted proxies; empty if unknown."""
    client = scope.get("client")
    return client[0] if client else ""


def find_peer(scope: Scope) -> str:
    """Address at the other end of the connection, possibly a proxy's."""
    return scope.get("state", {}).get("peer") or find_source(scope)


@lru_cache(4096)
def find_network(host: str) -> str:
    """Common part of the addresses of a site: of IPv6 the first 64 bits."""
    address = _read_address(host)
    if address is None or address.version == 4:
        return host
    return str(ipaddress.ip_network((int(address), 64), strict=False))


class ForwardedHeaders:
    """Replaces a trusted proxy by the client whose request it forwards.

    Before all other middleware; `find_peer` still gives the proxy.

    root_path : path at which the proxies show the service; one that a trusted proxy
        names takes precedence. It may still be in the requests that they pass on
    """

    def __init__(
        self, app: ASGIApp, trusted_proxies: Collection[str] = (), root_path: str = ""
    ) -> None:
        self._app, self._trusted = app, trusted_proxies
        self._root_path = root_path.rstrip("/")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] in ("http", "websocket"):
            scope.setdefault("state", {})["peer"] = peer = find_source(scope)
            BASE.set(self._root_path)
            if is_trusted_proxy(peer, self._trusted):
                self._apply_headers(scope)
            path = "/" + scope["path"].lstrip("/")
            if f"{path}/".startswith(f"{BASE.get()}/") and not path.startswith(PREFIX):
                path = path.removeprefix(BASE.get()) or "/"
            scope["path"], scope["state"]["base"] = path, BASE.get()
        await self._app(scope, receive, send)

    def _apply_headers(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        prefix = headers.get("x-forwarded-prefix", "").rstrip("/")
        if ROOT_PATH.fullmatch(prefix):
            BASE.set(prefix)
        scheme = headers.get("x-forwarded-proto", "").strip()
        if scheme in _SCHEMES:
            is_socket = scope["type"] == "websocket"
            scope["scheme"] = _SCHEMES[scheme] if is_socket else scheme
        # Each proxy appends: entries before a stranger's are unverified.
        for one in reversed(",".join(headers.getlist(_FOR)).split(",")):
            address = _read_address(one)
            if address is None:
                return
            scope["client"] = str(address), 0
            if not is_trusted_proxy(str(address), self._trusted):
                return


def _read_address(
    given: str,
) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Accepts `address`, `address:port` and `[address]:port`."""
    given = given.strip()
    for host in (lambda: given, lambda: urlsplit(f"//{given}").hostname or ""):
        with suppress(ValueError):
            address = ipaddress.ip_address(host())
            return getattr(address, "ipv4_mapped", None) or address
    return None
