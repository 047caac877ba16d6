"""Writes the description of the interface: `python -m app.api.openapi FILE`.

The file is checked in, so that a change of the interface is seen as one in review.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from app.api.application import create_application


def description() -> str:
    """Return the OpenAPI document as the checked-in file holds it."""
    document = create_application().openapi()
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(description(), encoding="utf-8")
