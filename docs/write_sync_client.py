"""Writes `app/truepath/client/sync_client.py` from `async_client.py`, which is edited.

Both faces have the same methods; what differs is in the words of `_WORDS` alone.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

CLIENT = Path(__file__).parents[1] / "app" / "truepath" / "client"
_HEAD = "# Written by docs/write_sync_client.py from async_client.py; change that.\n"
_WORDS = (
    (r"for programs on asyncio", "for programs that wait for each answer"),
    (r"async for item in (.*):\n +yield item\n", r"yield from \1\n"),
    (r"for item in (.*):\n +yield item\n", r"yield from \1\n"),
    (r"\basync (def|with|for) ", r"\1 "),
    (r"\bawait ", ""),
    (r"\bAsync(Client|Iterator|BaseTransport)\b", r"\1"),
    (r"\b(__|\b)a(enter|exit|close|read)(?=\b|__)", r"\1\2"),
    (r"\bimport asyncio\n", "import time\n"),
    (r"\basyncio\.sleep\b", "time.sleep"),
)


def write_sync(text: str) -> str:
    """Return the client that waits, from the text of the one on asyncio."""
    for pattern, word in _WORDS:
        text = re.sub(pattern, word, text)
    formatter = [sys.executable, "-m", "ruff", "format", "-"]
    done = subprocess.run(  # noqa: S603 (our own formatter)
        formatter, input=_HEAD + text, capture_output=True, text=True, check=True
    )
    return done.stdout


if __name__ == "__main__":
    source = (CLIENT / "async_client.py").read_text("utf-8")
    (CLIENT / "sync_client.py").write_text(write_sync(source), "utf-8")
