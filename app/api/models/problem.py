"""What went wrong, as clients see it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from app.api.models.base import JOB_ID


class Problem(BaseModel):
    """What went wrong and the way out (RFC 9457)."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["/problems/busy"])
    title: str = Field(examples=["Another job holds the machine"])
    status: int | None = Field(None, examples=[409])
    detail: str = Field(examples=[f"job {JOB_ID} (running) holds the machine"])
    code: str = Field(examples=["busy"])
    action: str = Field(examples=["Wait until current_job has ended, or abort it."])
    instance: str | None = Field(None, examples=["/api/v1/jobs"])
    request_id: str | None = Field(None, examples=["6f0e4c1b9a7d4e52"])
