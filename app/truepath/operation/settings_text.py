"""The settings as text: all with their meaning, or those in effect without secrets."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from truepath.settings import Settings

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
