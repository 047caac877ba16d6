"""Parameters that several routes share: idempotency key, version, page of a list.

The version of a job is in ETag and If-Match. A page is named by an opaque cursor; the
Link header leads to the next one.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import Depends, Header, Query, Request, Response
from pydantic import BaseModel, StringConstraints
from pydantic.json_schema import SkipJsonSchema
from starlette.exceptions import HTTPException

from truepath.catalogue.job import Job
from truepath.catalogue.runs import RunRecord
from truepath.catalogue.store import IdempotencyKey
from truepath.errors import BadInput
from truepath.service.api.models.base import BASE

IdempotencyKeyHeader = Annotated[
    Annotated[
        str, StringConstraints(min_length=1, max_length=200, pattern=r"^[\x21-\x7e]+$")
    ]
    | SkipJsonSchema[None],
    Header(description="Of your choice: the same key and body make one job, once."),
]
_TAG = re.compile(r'^"?(\d{1,9})"?$')  # a weak tag matches nothing (RFC 9110)


def make_key(
    key: str | None, kind: str, request: BaseModel, owner: str | None
) -> IdempotencyKey | None:
    """Key of a request with its body and its owner; None without a key."""
    body = f"{kind}{request.model_dump_json(exclude_defaults=True)}".encode()
    return IdempotencyKey(key, body, owner) if key else None


def format_etag(job: Job) -> str:
    """Version of a job, in quotes."""
    return f'"{job.version}"'


def _version(
    if_match: Annotated[
        str,
        Header(description='Version that was read, `"<version>"`.', examples=['"3"']),
    ] = "",
) -> int:
    if not if_match or if_match.strip() == "*":
        raise HTTPException(428, "say by If-Match which version you have read")
    match = _TAG.match(if_match.strip())
    if match is None:
        raise HTTPException(412, f"If-Match {if_match!r} is no version")
    return int(match[1])


Version = Annotated[int, Depends(_version)]


def _version_if_given(
    if_match: Annotated[
        str,
        Header(
            description='Version that was read, `"<version>"`; without it any.',
            examples=['"3"'],
        ),
    ] = "",
) -> int | None:
    is_any = not if_match or if_match.strip() == "*"
    return None if is_any else _version(if_match)


VersionIfGiven = Annotated[int | None, Depends(_version_if_given)]


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
