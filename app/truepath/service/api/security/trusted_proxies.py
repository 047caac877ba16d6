"""Forwarded headers of the proxies in the settings; all others are ignored."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection, Iterable
from contextlib import suppress
from functools import lru_cache
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from truepath.service.api.models.base import BASE, PREFIX

ROOT_PATH = re.compile(r"(/[\w.~-]+)+", re.ASCII)
_FOR = "x-forwarded-for"
_SCHEMES = {"http": "ws", "https": "wss"}


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
