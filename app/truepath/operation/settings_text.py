"""The settings as text: all with their meaning, or those in effect without secrets."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

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

_EXAMPLES: Mapping[str, str] = {
    "data_dir": '"/srv/truepath"',
    "database_url": '"postgresql+psycopg://truepath@db.example/truepath"',
    "database_password_file": '"/etc/truepath/database_password"',
    "temperature_drift_limit_degC": "0.5",
    "tls_cert": '"/etc/truepath/cert.pem"',
    "tls_key": '"/etc/truepath/key.pem"',
    "trusted_hosts": '["calibration.plant.example"]',
    "trusted_proxies": '["127.0.0.1", "10.0.0.0/8"]',
    "root_path": '"/truepath"',
    "machine_file": '"/etc/truepath/machine.json"',
    "tracker_options": '{ port = "/dev/serial/by-id/usb-tracker-if00-port0" }',
    "motion_options": '{ host = "192.0.2.10", port = 502, unit = 1 }',
    "tracker_patience_s": "{ silent = 0.5, point = 20 }",
    "thermometer_driver": '"modbus-registers"',
    "thermometer_options": '{ host = "192.0.2.11", registers = '
    '[{ name = "X_degC", unit = 1, address = 0, type = "int16", scale = 0.1 }] }',
    "tracker_light": "{ wavelength_nm = 633, assumed_index = 1.00027 }",
    "simulated_faults": '["tracker:drop*0.001"]',
    "simulated_hidden": '["backlash*4"]',
    "dask_scheduler": '"tcp://192.0.2.20:8786"',
    "log_file": '"/var/log/truepath/service.log"',
}
"""What a setting without a default may look like."""


@dataclass(frozen=True, slots=True)
class SettingText:
    """One setting: `default` and `example` as TOML, empty where there is none."""

    name: str
    default: str
    example: str
    meaning: str
    environment: str


def list_settings() -> Iterator[SettingText]:
    """In the order in which they are declared."""
    for name, field in Settings.model_fields.items():
        yield SettingText(
            name,
            _write_default(field),
            _EXAMPLES.get(name, ""),
            " ".join((field.description or "").split()),
            f"TRUEPATH_{name.upper()}",
        )


def write_example() -> str:
    """TOML with every setting as a comment."""
    lines = [
        "# Settings of Truepath; what is commented out is the default, or an example.",
        "# Environment variables TRUEPATH_… beat this file.",
    ]
    for one in list_settings():
        lines += ["", *_wrap(one.meaning)]
        lines.append(f"# {one.name} = {one.default or one.example}")
    return "\n".join(lines) + "\n"


def write_toml(value: object) -> str:
    """As TOML; JSON strings and arrays are TOML as well."""
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(k)} = {write_toml(v)}" for k, v in value.items())
        return f"{{ {', '.join(pairs)} }}" if value else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(write_toml(one) for one in value)}]"
    if isinstance(value, Path):
        value = str(value)
    return json.dumps(value, ensure_ascii=False)


def _write_default(field: FieldInfo) -> str:
    """Empty where there is no default."""
    if field.default_factory is not None:
        made: Any = field.default_factory
        # A folder of the user's is another one on every computer.
        return write_toml({}) if made is dict else ""
    has_none = field.default is None or field.default is PydanticUndefined
    return "" if has_none else write_toml(field.default)


def _wrap(text: str, width: int = 84) -> list[str]:
    import textwrap

    return [f"# {line}" for line in textwrap.wrap(text, width)]


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
