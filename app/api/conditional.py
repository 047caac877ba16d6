"""Versions of a job in ETag and If-Match."""

from __future__ import annotations

import re
from typing import Annotated

from fastapi import Depends, Header
from starlette.exceptions import HTTPException

from app.jobs.job import Job

_TAG = re.compile(r'^(?:W/)?"?(\d{1,9})"?$')


def format_etag(job: Job) -> str:
    """Return the ETag of a job: its version."""
    return f'"{job.version}"'


def _version(
    if_match: Annotated[
        str,
        Header(description='Version that was read, `"<version>"`.', examples=['"3"']),
    ] = "",
) -> int:
    """Return the version that If-Match names. 428 without, 412 if it names none."""
    if not if_match or if_match.strip() == "*":
        raise HTTPException(
            428, "this moves the machine: say which version you have read"
        )
    match = _TAG.match(if_match.strip())
    if match is None:
        raise HTTPException(412, f"If-Match {if_match!r} is no version of a job")
    return int(match[1])


Version = Annotated[int, Depends(_version)]
