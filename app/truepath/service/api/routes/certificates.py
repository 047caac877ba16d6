"""Certificates of a result: numbered, stored with it, never changed."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Any, Literal

from anyio import CapacityLimiter
from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse
from pydantic import AliasChoices, AwareDatetime, BaseModel, Field

from truepath.answers.certificate.stated_results import StatedResults
from truepath.catalogue.machine_registry import (
    MachineRecord,
    describe_identity,
    find_machine,
    store_identity,
)
from truepath.child_process import WorkerProcess
from truepath.errors import NotFound
from truepath.files.bundle.identity_file import EARLIER_NAMES, Identity
from truepath.files.earlier.verdict import State as VerdictState
from truepath.service.api.access_control import note_change
from truepath.service.api.models.base import (
    CertificateNumber,
    CompensationName,
    Identifier,
    JobId,
    Links,
    Name,
    RequestBody,
    examples,
)
from truepath.service.api.problems import declare_file, declare_problems
from truepath.service.api.routes.results import get_machine_tolerance_um, send_page
from truepath.service.api.service import ActorDep, Service, ServiceDep, on_threads
from truepath.users.roles import Actor

if TYPE_CHECKING:
    from truepath.answers.certificate.issue import CertificateOrder

router = APIRouter(tags=["certificates"])

# One at a time: each is laid out in a separate process.
_TURN = Lock()
_ISSUING = CapacityLimiter(2)


Language = Literal["en", "de"]


def _either(name: str) -> AliasChoices:
    """The name of today, or the earlier one."""
    earlier = (old for old, new in EARLIER_NAMES.items() if new == name)
    return AliasChoices(name, *earlier)


class IdentityIn(RequestBody):
    """What people state; all may be left out, and an empty text is as good as none.

    The registry of machines keeps it, except the entries of one measurement.
    """

    machine_maker: Name = ""
    machine_model: Name = ""
    serial_number: Name = Field("", validation_alias=_either("serial_number"))
    control: Name = ""
    tracker: Name = Field("", description="Maker and model.")
    tracker_serial_number: Name = Field(
        "", validation_alias=_either("tracker_serial_number")
    )
    tracker_certificate: Name = Field("", description="Number of its own certificate.")
    tracker_calibrated_on: Name = ""
    target: Name = Field("", description="Reflector: kind and serial number.")
    operator: Name = ""
    laboratory: Name = Field("", description="Name and address.")
    customer: Name = Field("", description="Name and contact.")
    place: Name = ""
    authorised_by: Name = Field("", description="Who signs the certificate.")
    condition: Name = Field("", description="Of the machine now; not kept.")
    received_on: Name = Field("", description="Date; not kept.")
    measured_on: Name = Field("", description="Date of this measurement; not kept.")
    warm_up: Name = Field("", description="Of this measurement; not kept.")
    deviations: Name = Field("", description="From the method; not kept.")


class CertificateRequest(RequestBody):
    """Which certificate to issue of a result."""

    model_config = examples(
        {
            "language": "en",
            "identity": {"serial_number": "4711", "operator": "A. Weiß"},
        }
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
    results: StatedResults | None = Field(
        None,
        description="Main numbers as its pages state them. Certificates of earlier "
        "versions do not have them.",
    )
    sources_sha256: dict[str, str] = Field(description="Files it was made from.")
    files: dict[str, str] = Field(description="SHA-256 by name; no PDF, none could be.")
    links: CertificateLinks


class CertificatePreview(BaseModel):
    """What issuing would make."""

    html: str = Field(description="One page, each of its sheets marked as a preview.")
    results: StatedResults


class CertificateList(BaseModel):
    """All certificates of a result, in the order they were issued."""

    items: list[CertificateOut]
    identity: dict[str, str] = Field(
        description="What the registry has of the machine, to look at before the next."
    )


# What computes is imported where it does: the service itself carries no science.


@router.post(
    "/jobs/{job_id}/certificates/preview", responses=declare_problems(404, 422)
)
@on_threads(_ISSUING)
def preview_certificate(
    job_id: JobId, body: CertificateRequest, service: ServiceDep, actor: ActorDep
) -> CertificatePreview:
    """Return what issuing would make, marked as a preview; nothing is kept."""
    from truepath.answers.certificate.issued_certificates import (
        preview_certificate as preview,
    )

    order = _make_order(service, job_id, body, actor)
    known = describe_identity(_find_machine(service, order.result))
    order = replace(order, identity={**known, **_list_stated_identity(body)})
    with _TURN, closing(WorkerProcess("printer")) as printer:
        return CertificatePreview(**printer.call(partial(preview, order)))


@router.post(
    "/jobs/{job_id}/certificates",
    status_code=201,
    responses=declare_problems(404, 422),
)
@on_threads(_ISSUING)
def issue_certificate(
    job_id: JobId,
    body: CertificateRequest,
    request: Request,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
) -> CertificateOut:
    """Issue a certificate of a result, as HTML and PDF, and keep it with the result.

    It gets a number and never changes; another request issues another. What is stated
    of the machine is kept, so that it has to be stated once.
    """
    from truepath.answers.certificate import issued_certificates as certificates

    order = _make_order(service, job_id, body, actor)
    machine = _find_machine(service, order.result)
    identity = store_identity(
        machine, _list_stated_identity(body), service.setup.registry
    )
    order = replace(order, identity=identity)
    with _TURN, closing(WorkerProcess("printer")) as printer:
        folder = order.result.parent / certificates.FOLDER
        record = printer.call(partial(certificates.issue_certificate, order, folder))
    issued = _describe(job_id, record)
    note_change(request, old={}, new={"number": issued.number, **issued.files})
    response.headers["Location"] = issued.links.self
    return issued


@router.get("/jobs/{job_id}/certificates", responses=declare_problems(404))
def list_certificates(job_id: JobId, service: ServiceDep) -> CertificateList:
    """List the certificates of a result, and what is kept of its machine."""
    from truepath.answers.certificate import issued_certificates as certificates

    folder = _find_folder(service, job_id)
    machine = _find_machine(service, _find_answer(service, job_id, "result.json"))
    return CertificateList(
        items=[
            _describe(job_id, one) for one in certificates.list_certificates(folder)
        ],
        identity=dict(describe_identity(machine)),
    )


@router.get(
    "/jobs/{job_id}/certificates/{number}.html",
    response_class=HTMLResponse,
    responses=declare_problems(404, 422),
)
def get_certificate_page(
    job_id: JobId, number: CertificateNumber, service: ServiceDep
) -> FileResponse:
    """Return a certificate as one page that needs nothing else."""
    return send_page(_find_file(service, job_id, number, "html"))


@router.get(
    "/jobs/{job_id}/certificates/{number}.pdf",
    response_class=FileResponse,
    responses=declare_file("application/pdf", 404, 422),
)
def get_certificate_pdf(
    job_id: JobId, number: CertificateNumber, service: ServiceDep
) -> FileResponse:
    """Return a certificate as PDF."""
    file = _find_file(service, job_id, number, "pdf")
    return FileResponse(file, media_type="application/pdf", filename=f"{number}.pdf")


@router.get("/jobs/{job_id}/certificates/{number}", responses=declare_problems(404))
def get_certificate(
    job_id: JobId, number: CertificateNumber, service: ServiceDep
) -> CertificateOut:
    """Return what a certificate was issued from, by whom, and its digests."""
    from truepath.answers.certificate import issued_certificates as certificates

    folder = _find_folder(service, job_id)
    return _describe(job_id, certificates.read_certificate(folder, number))


def _find_folder(service: Service, job_id: str) -> Path:
    return service.results / service.store.get(job_id).id / "certificates"


def _find_file(
    service: Service, job_id: str, number: str, form: Literal["html", "pdf"]
) -> Path:
    from truepath.answers.certificate.issued_certificates import get_certificate_file

    return get_certificate_file(_find_folder(service, job_id), number, form)


def _find_answer(service: Service, job_id: str, name: str) -> Path:
    file = service.results / service.store.get(job_id).id / name
    if not file.is_file():
        raise NotFound(f"job {job_id} has no {name}")
    return file


def _find_compensation_record(
    service: Service, folder: Path, body: CertificateRequest
) -> Path | None:
    from truepath.compensation.stored_files import find_file

    if body.compensation_id is not None:
        kept = folder / "compensations"
        return find_file(kept, body.compensation_id, "compensation.json")
    if body.verification_job is None:
        return None
    asked = service.store.read_plan_request(body.verification_job)
    if asked.get("compensation_id") is None:
        return None
    kept = service.results / str(asked["result_id"]) / "compensations"
    file = kept / str(asked["compensation_id"]) / "compensation.json"
    # Deleted since: the certificate then states that no record was given.
    return file if file.is_file() else None


def _make_order(
    service: Service, job_id: str, body: CertificateRequest, actor: Actor | None
) -> CertificateOrder:
    """Without the identity."""
    from truepath.answers.certificate.issue import CertificateOrder

    result, now = _find_answer(service, job_id, "result.json"), datetime.now(UTC)
    left, proof = body.as_left_job, body.verification_job
    return CertificateOrder(
        f"TP-{now:%Y%m%d}-{job_id.replace('-', '')[-8:].upper()}",
        result,
        now,
        actor.name if actor else "",
        _find_answer(service, left, "result.json") if left else None,
        _find_answer(service, proof, "verification.json") if proof else None,
        _find_compensation_record(service, result.parent, body),
        language=body.language,
        accept_verdict=body.accept_verdict,
        tolerance_um=get_machine_tolerance_um(service, job_id),
    )


def _list_stated_identity(body: CertificateRequest) -> Identity:
    return {k: v for k, v in body.identity.model_dump().items() if v.strip()}


def _find_machine(service: Service, result: Path) -> MachineRecord | None:
    from truepath.documents.file_model import as_object, parse_json

    job = service.store.get(result.parent.name)
    content = as_object(parse_json(result.read_bytes(), result.name))
    name = str(as_object(content.get("machine")).get("name", ""))
    return find_machine(job, name, service.setup.registry)


def _describe(job_id: str, record: dict[str, Any]) -> CertificateOut:
    links = CertificateLinks.of(job=job_id, number=record["number"])
    return CertificateOut(**{**record, "links": links})
