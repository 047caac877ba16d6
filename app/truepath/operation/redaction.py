"""Removes secrets from settings and texts before another person reads them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from truepath.errors import BadInput
from truepath.settings import Settings

HIDDEN = "[hidden]"

_SECRET_NAME = re.compile(
    r"pass(word|wd|phrase|code)?$|secret|token|credential|api_?key|private_?key|^pin$"
    r"|^auth|^key$",
    re.IGNORECASE,
)
_SHORTEST = 4
"""Of a secret that is searched for in texts: a shorter one is in every line."""
_PATTERNS = (
    (
        re.compile(
            r"-----BEGIN [^-]*PRIVATE KEY-----.*?(-----END [^-]*PRIVATE KEY-----|\Z)",
            re.DOTALL,
        ),
        HIDDEN,
    ),
    (re.compile(r"(\w[\w+.-]*://[^\s/@:\"']*):[^\s/@\"']+@"), rf"\1:{HIDDEN}@"),
    (re.compile(r"\btp_[\w-]{8,}"), HIDDEN),
    (re.compile(r"(?i)\b(bearer|basic)\s+[\w.~+/=-]{6,}"), rf"\1 {HIDDEN}"),
    (re.compile(r"(truepath_session=)[^;\s\"']+"), rf"\1{HIDDEN}"),
    (re.compile(r"\$argon2\w*\$[^\s\"']+"), HIDDEN),
    (
        re.compile(
            r"(?i)([\w-]*(?:password|passwd|passphrase|secret|token|api_?key|credential)"
            r"s?[\"']?\s*[=:]\s*)(\"[^\"]*\"|'[^']*'|[^\s,;}\"']+)"
        ),
        rf"\1{HIDDEN}",
    ),
)


class Redactor:
    """Hides the secrets of some settings, and texts that look like one."""

    def __init__(self, settings: Settings) -> None:
        secrets = {s for s in _list_secrets(settings) if len(s) >= _SHORTEST}
        # The longest first: one may be a part of another.
        self._secrets = sorted(secrets, key=len, reverse=True)

    def redact(self, text: str) -> str:
        """With `HIDDEN` in place of each secret."""
        for secret in self._secrets:
            text = text.replace(secret, HIDDEN)
        for pattern, instead in _PATTERNS:
            text = pattern.sub(instead, text)
        return text


def redact_settings(settings: Settings) -> Iterator[tuple[str, Any]]:
    """Every setting by name, as plain values, its secrets hidden.

    Names of files that hold a secret stay: their content is never read.
    """
    redactor = Redactor(settings)
    for name, value in settings.model_dump(mode="json").items():
        yield name, _redact_value(value, redactor)


def _redact_value(value: Any, redactor: Redactor) -> Any:
    if isinstance(value, Mapping):
        return {
            key: HIDDEN if _is_secret(key, one) else _redact_value(one, redactor)
            for key, one in value.items()
        }
    if isinstance(value, list):
        return [_redact_value(one, redactor) for one in value]
    return redactor.redact(value) if isinstance(value, str) else value


def _is_secret(key: str, value: Any) -> bool:
    return bool(_SECRET_NAME.search(key)) and not isinstance(value, Mapping | list)


def _list_secrets(settings: Settings) -> Iterator[str]:
    for value in settings.model_dump(mode="json").values():
        yield from _find_secrets(value)
    from sqlalchemy import make_url

    try:
        password = make_url(settings.database).password
    except BadInput:  # its file cannot be read; reported on connection
        return
    if password is not None:
        yield str(password)


def _find_secrets(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, one in value.items():
            if _is_secret(key, one):
                yield str(one)
            else:
                yield from _find_secrets(one)
    elif isinstance(value, list):
        for one in value:
            yield from _find_secrets(one)
