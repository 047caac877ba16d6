"""Name and note of a job or a Run."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field, StringConstraints
from pydantic.json_schema import SkipJsonSchema

from truepath.documents.file_model import LONGEST_LINE, UNPRINTED
from truepath.service.api.models.base import RequestBody

_PRINTED = f"[^{UNPRINTED}]"
_PRINTED_OR_BREAK = (
    "[^\\u0000-\\u0008\\u000b-\\u001f\\u007f-\\u009f\\u2028-\\u202e\\u2066-\\u2069]"
)
Name = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED}*$", max_length=LONGEST_LINE)
]
RunName = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED}+$", min_length=1, max_length=200)
]
Note = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED_OR_BREAK}*$", max_length=2000)
]


class JobNaming(RequestBody):
    """Name and note of a job. What is left out stays as it is."""

    model_config = ConfigDict(
        extra="forbid",
        str_max_length=2000,
        json_schema_extra={"examples": [{"name": "As found, before the new spindle"}]},
    )

    name: Name | SkipJsonSchema[None] = Field(
        None, description="Empty: none.", examples=["As found"]
    )
    note: Note | SkipJsonSchema[None] = Field(
        None, description="Lines are broken by \\n.", examples=["Warm since 8:00."]
    )


class RunNaming(JobNaming):
    """Name and note of a Run. What is left out stays as it is."""

    name: RunName | SkipJsonSchema[None] = Field(
        None, description="A Run has one always.", examples=["As found"]
    )
