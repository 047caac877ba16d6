"""What all bodies share: where the interface is, bounds of numbers sent in."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

PREFIX = "/api/v1"
JOB_ID = "019a3f5e-7a11-7c3e-9d64-2b1f0c5e8a90"
OTHER_ID = "019a3f6b-0c52-7e41-8a3d-5f7e9b1c2d34"
"""The job of all examples."""

Mm = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Deg = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
Feed = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
TargetUm = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Dwell = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]
Identifier = Annotated[
    str, StringConstraints(pattern=r"^[0-9a-zA-Z-]+$", max_length=36)
]


class RequestBody(BaseModel):
    """What clients send: nothing else is in it."""

    model_config = ConfigDict(extra="forbid", str_max_length=200)
