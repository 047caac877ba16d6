"""Pieces of HTML: every text that comes from outside is escaped here."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from app.results.numbers_as_text import expanded
from app.results.volumetric_error import Figure


def escape(text: object) -> str:
    """Return the text as it may stand in HTML."""
    return html.escape(str(text), quote=True)


def figure_text(figure: Figure) -> str:
    """Return a figure in µm with its expanded uncertainty."""
    return expanded(figure.value_um, figure.uncertainty_um)


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: int = 0
) -> str:
    """Return a table of escaped cells; columns from `numbers` on are right-aligned."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=n' if i >= numbers else ''}>{cell}</{tag}>"
            for i, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return (
        f"<div class=scroll><table><thead><tr>{cells('th', head)}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Return a list of names with escaped values."""
    return f"<dl>{''.join(f'<dt>{n}</dt><dd>{v}</dd>' for n, v in pairs)}</dl>"


def tile(value: str, unit: str, title: str, text: str, mood: str = "") -> str:
    """Return one number of the summary."""
    return (
        f'<div class="tile {mood}"><em>{title}</em><b>{value} <small>{unit}</small></b>'
        f"<i>{text}</i></div>"
    )


def drawing(svg: str, caption: str) -> str:
    """Return a figure with its caption."""
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def section(number: int, title: str, *content: str) -> str:
    """Return a numbered section."""
    return (
        f"<section><h2><span>{number}</span>{title}</h2>{''.join(content)}</section>\n"
    )


def callout(text: str, *, warn: bool = False) -> str:
    """Return a paragraph that stands out."""
    return f'<div class="callout{" warn" if warn else ""}"><p>{text}</p></div>'
