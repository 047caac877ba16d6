"""Pages of a list by an opaque cursor, and the Link header that leads to the next."""

from __future__ import annotations

import base64
import binascii
from typing import Annotated

from fastapi import Query, Request, Response
from pydantic import StringConstraints
from pydantic.json_schema import SkipJsonSchema

from app.errors import BadInput

Limit = Annotated[int, Query(ge=1, le=200, description="Entries on a page.")]
After = Annotated[
    Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_=-]+$")]
    | SkipJsonSchema[None],
    Query(description="`next` of the page before.", examples=["czoxMg=="]),
]


def cursor(seq: int) -> str:
    """Return the cursor that stands after an entry."""
    return base64.urlsafe_b64encode(f"s:{seq}".encode()).decode()


def place(after: str | None) -> int | None:
    """Return where a cursor stands. Raises BadInput if it is none of ours."""
    if after is None:
        return None
    try:
        kind, _, digits = (
            base64.urlsafe_b64decode(after.encode()).decode().partition(":")
        )
        seq = int(digits)
    except (binascii.Error, UnicodeDecodeError, ValueError) as error:
        raise BadInput(
            f"after: {after!r} is no cursor; use `next` of a page"
        ) from error
    if kind != "s" or not 0 <= seq < 2**63:
        raise BadInput(f"after: {after!r} is no cursor; use `next` of a page")
    return seq


def link_next(request: Request, response: Response, after: str | None) -> None:
    """Point to the next page in the Link header, where there is one."""
    if after is not None:
        url = request.url.include_query_params(after=after)
        response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
