"""Writes the catalogue of effects in discovery.md from the installed effects.

python docs/write_discovery_catalogue.py [--check]
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from truepath.kinematics.effects.family import Family, list_families

PAGE = Path(__file__).with_name("discovery.md")
_PLACE = re.compile(
    r"(<!-- discovery-catalogue -->\n).*?(<!-- /discovery-catalogue -->)", re.S
)


def _row(family: Family) -> str:
    words = family.words["en"]
    home = "machine" if family.is_kept else "measurement"
    name = f"`{family.name}`" + (" *" if not family.names_cause else "")
    cells = (name, words.cause, words.looks_like, words.remedy, home)
    return f"| {' | '.join(cells)} |"


def catalogue() -> str:
    """Return the table of all installed effects."""
    head = "| name | cause | looks like | what to do | of the |\n|" + " --- |" * 5
    return "\n".join([head, *map(_row, list_families())]) + "\n"


def filled(page: str) -> str:
    """Return the page with the catalogue written anew."""
    return _PLACE.sub(lambda m: f"{m[1]}{catalogue()}{m[2]}", page)


def main() -> int:
    """Write the page, or with --check tell whether it is up to date."""
    old = PAGE.read_text(encoding="utf-8")
    new = filled(old)
    if "--check" in sys.argv[1:]:
        return int(old != new)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
