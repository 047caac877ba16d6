"""Writes the table of settings.md from the settings of the service.

python docs/write_settings.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from truepath.app.operation.settings_text import SettingText, list_settings

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


def main() -> int:
    """Write the page, or say whether it has to be written."""
    old = PAGE.read_text(encoding="utf-8")
    head, rest = old.split(BEGIN)
    new = f"{head}{BEGIN}\n{write_table()}\n{END}{rest.split(END)[1]}"
    if "--check" in sys.argv:
        return int(new != old)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
