"""Colours and sizes of the certificate's pictures: the same on screen and on paper.

Printers do not resolve variables of a style sheet: colours and font are literal.
"""

from __future__ import annotations

import re

from markupsafe import Markup

FONT = "DejaVu Sans, Verdana, Arial, sans-serif"
_PAPER = {
    "ink": "#16202b",
    "muted": "#4a5663",
    "rule": "#d5dbe2",
    "accent": "#1f63c6",
    "second": "#b45309",
    "third": "#0f7b6c",
}
_VARIABLE = re.compile(r"var\(--([a-z]+)\)")


def inline_colours(figure: Markup) -> Markup:
    """The figure with literal colours and font."""
    text = _VARIABLE.sub(lambda found: _PAPER[found.group(1)], figure)
    # Colours and a font of this module: nothing from outside is in them.
    return Markup(text.replace("<svg ", f'<svg font-family="{FONT}" ', 1))  # noqa: S704
