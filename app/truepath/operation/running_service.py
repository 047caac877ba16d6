"""The service: its port, and whether one runs on this data folder already."""

from __future__ import annotations

import json
import ssl
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from typing import Any

from truepath.catalogue.errors import InUse
from truepath.catalogue.locks import hold_folder
from truepath.errors import BadInput
from truepath.settings import Settings

_ANSWER_S = 5.0
_ANY = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 (of all hosts, this one)


@dataclass(frozen=True, slots=True)
class RunningService:
    """Whether a service holds the data folder, and its own report.

    answers : at the address that is set
    system : its `GET /system`; None where it does not answer or requires a login first
    """

    is_there: bool
    answers: bool = False
    system: dict[str, Any] | None = None


def find_service(settings: Settings) -> RunningService:
    """The service that holds the data folder of these settings, if there is one."""
    if not settings.data_dir.exists():
        return RunningService(is_there=False)
    try:
        with hold_folder(settings.data_dir):
            return RunningService(is_there=False)
    except InUse:
        answers = _get_json(settings, "/healthz") is not None
        system = _get_json(settings, "/api/v1/system") if answers else None
        return RunningService(True, answers, system)
    except BadInput:  # the folder cannot be written; a separate finding
        return RunningService(is_there=False)


def read_metrics(settings: Settings) -> str | None:
    """None where the service gives no metrics without a login."""
    content = _fetch(settings, "/metrics")
    return None if content is None else content.decode("utf-8", "replace")


def _get_json(settings: Settings, path: str) -> dict[str, Any] | None:
    content = _fetch(settings, path)
    try:
        told = None if content is None else json.loads(content)
    except ValueError:
        return None
    return told if isinstance(told, dict) else None


def _fetch(settings: Settings, path: str) -> bytes | None:
    link = _connect(settings)
    try:
        link.request("GET", path)
        answer = link.getresponse()
        content = answer.read()
    except (OSError, HTTPException):
        return None
    finally:
        link.close()
    return content if answer.status == HTTPStatus.OK else None


def _connect(settings: Settings) -> HTTPConnection:
    host = _ANY.get(settings.host, settings.host)
    if settings.tls_cert is None:
        return HTTPConnection(host, settings.port, timeout=_ANSWER_S)
    context = ssl.create_default_context(cafile=settings.tls_cert)
    context.check_hostname = False  # called by address; the certificate has a name
    return HTTPSConnection(host, settings.port, timeout=_ANSWER_S, context=context)
