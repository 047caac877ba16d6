"""Certificates: what is asked for, and what was issued."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from truepath.app.api.models.base import (
    CompensationName,
    Identifier,
    Links,
    RequestBody,
)
from truepath.app.api.models.naming import Name
from truepath.app.files.verdict import State as VerdictState

Language = Literal["en", "de"]


class IdentityIn(RequestBody):
    """What people state; all may be left out, and an empty text is as good as none.

    The registry of machines keeps it, but for the last two.
    """

    machine_maker: Name = ""
    machine_model: Name = ""
    machine_serial: Name = ""
    control: Name = ""
    tracker: Name = Field("", description="Maker and model.")
    tracker_serial: Name = ""
    tracker_certificate: Name = Field("", description="Number of its own certificate.")
    tracker_calibrated_on: Name = ""
    target: Name = Field("", description="Reflector: kind and serial number.")
    operator: Name = ""
    laboratory: Name = Field("", description="Who issues the certificate.")
    customer: Name = ""
    place: Name = ""
    warm_up: Name = Field("", description="Of this measurement; not kept.")
    measured_on: Name = Field("", description="Date of this measurement; not kept.")


class CertificateRequest(RequestBody):
    """Which certificate to issue of a result."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "language": "en",
                    "identity": {"machine_serial": "4711", "operator": "A. Weiß"},
                }
            ]
        },
    )

    language: Language = "en"
    identity: IdentityIn = Field(default_factory=lambda: IdentityIn.model_validate({}))
    as_left_job: Identifier | None = Field(
        None, description="A job whose result was measured after compensation."
    )
    verification_job: Identifier | None = Field(
        None, description="A job that has left a verification."
    )
    compensation_id: CompensationName | None = Field(
        None,
        description="Files that were made of this result; those that the verification "
        "was made with, where it is left out.",
        examples=[None],
    )
    accept_verdict: bool = Field(
        False, description="Issue one of a result that is not to be used."
    )


class CertificateLinks(Links):
    """Where the certificate is."""

    self: Annotated[str, "/jobs/{job}/certificates/{number}"]
    html: Annotated[str, "/jobs/{job}/certificates/{number}.html"]
    pdf: Annotated[str, "/jobs/{job}/certificates/{number}.pdf"]
    job: Annotated[str, "/jobs/{job}"]


class CertificateOut(BaseModel):
    """A certificate as it was issued; it never changes."""

    number: str = Field(examples=["TP-20261124-2B1F0C5E-1"])
    machine: str
    issued_at: AwareDatetime
    issued_by: str = Field(description="Empty where nobody had logged in.")
    language: Language
    verdict: VerdictState = Field(description="Of the result, as the first page says.")
    verdict_accepted: bool
    identity: dict[str, str] = Field(description="As stated; what is missing was not.")
    sources_sha256: dict[str, str] = Field(description="Files it was made from.")
    files: dict[str, str] = Field(description="SHA-256 by name; no PDF, none could be.")
    links: CertificateLinks


class CertificateList(BaseModel):
    """All certificates of a result, in the order they were issued."""

    items: list[CertificateOut]
    identity: dict[str, str] = Field(
        description="What the registry has of the machine, to look at before the next."
    )
