"""Headers of a request: its idempotency key, and the version it read.

The version of a job is in ETag and If-Match.
"""

from __future__ import annotations

import re
from typing import Annotated

from fastapi import Depends, Header
from pydantic import BaseModel, StringConstraints
from pydantic.json_schema import SkipJsonSchema
from starlette.exceptions import HTTPException

from truepath.catalogue.job import Job
from truepath.catalogue.store import IdempotencyKey

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
