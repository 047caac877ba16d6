"""Pages of a list by an opaque cursor, and the Link header to the next."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import Depends, Query, Request, Response
from pydantic import StringConstraints
from pydantic.json_schema import SkipJsonSchema

from truepath.catalogue.job import Job
from truepath.catalogue.runs import RunRecord
from truepath.errors import BadInput
from truepath.service.api.models.base import BASE

Limit = Annotated[int, Query(ge=1, le=200, description="Entries on a page.")]
After = Annotated[
    Annotated[str, StringConstraints(max_length=64, pattern=r"^[A-Za-z0-9_=-]+$")]
    | SkipJsonSchema[None],
    Query(description="`next` of the page before.", examples=["czoxMg=="]),
]


T = TypeVar("T", bound=Job | RunRecord)


class Paging:
    """`limit` and `after` of a request for a list; sets the Link header."""

    def __init__(
        self,
        request: Request,
        response: Response,
        limit: Limit = 50,
        after: After = None,
    ) -> None:
        self._request, self._response, self._limit = request, response, limit
        self._before_seq = None if after is None else _decode_cursor(after)

    def read(self, list_page: Callable[..., list[T]]) -> tuple[list[T], str | None]:
        """Entries of the page, and the cursor of the next one if any.

        list_page : gives at most so many entries older than `before_seq`, newest first
        """
        entries = list_page(self._limit + 1, before_seq=self._before_seq)
        if len(entries) <= self._limit:
            return entries, None
        cursor = f"s:{entries[self._limit - 1].seq}".encode()
        after = base64.urlsafe_b64encode(cursor).decode()
        url = self._request.url.include_query_params(after=after)
        next_page = f"{BASE.get()}{url.path}?{url.query}"
        self._response.headers["Link"] = f'<{next_page}>; rel="next"'
        return entries[: self._limit], after


PagingDep = Annotated[Paging, Depends(Paging)]


def _decode_cursor(after: str) -> int:
    try:
        text = base64.urlsafe_b64decode(after.encode()).decode()
        kind, _, digits = text.partition(":")
        seq = int(digits)
        if kind != "s" or not 0 <= seq < 2**63:
            raise ValueError(text)
    except (binascii.Error, UnicodeDecodeError, ValueError) as error:
        raise BadInput(
            f"after: {after!r} is no cursor; use `next` of a page"
        ) from error
    return seq
