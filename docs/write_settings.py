"""Writes the table of settings.md from the settings of the service.

python docs/write_settings.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from page_section import write_section

from truepath.operation.settings_text import SettingText, list_settings

PAGE = Path(__file__).with_name("settings.md")
BEGIN, END = "<!-- settings -->", "<!-- end of settings -->"


def write_table() -> str:
    """Return the table of all settings."""
    rows = [
        "| setting | default | meaning | environment |",
        "| --- | --- | --- | --- |",
    ]
    return "\n".join([*rows, *(_write_row(one) for one in list_settings())])


def _write_row(one: SettingText) -> str:
    default = f"`{one.default}`" if one.default else ""
    meaning = one.meaning.replace("|", "\\|")
    example = f" For example `{one.example}`." if one.example else ""
    return f"| `{one.name}` | {default} | {meaning}{example} | `{one.environment}` |"


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_table))
