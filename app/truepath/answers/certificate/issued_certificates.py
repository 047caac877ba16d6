"""Issued certificates, stored with their result: numbered, and never changed.

Each is a folder with its number for a name: `certificate.json`, the record;
`certificate.html`; and `certificate.pdf`, where this installation can print. A folder
is made under a temporary name and renamed when it is complete, so that a number has all
or nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

from truepath.answers.certificate.document import (
    PdfUnavailable,
    print_pdf,
    render_certificate,
    require_printer,
)
from truepath.answers.certificate.issue import (
    Certificate,
    CertificateOrder,
    gather_certificate,
    read_result_source,
)
from truepath.answers.certificate.stated_results import list_main_results
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import sync_to_disk, write_files
from truepath.errors import NotFound

_RECORD, HTML, PDF = "certificate.json", "certificate.html", "certificate.pdf"
FOLDER = "certificates"


def preview_certificate(order: CertificateOrder) -> dict[str, Any]:
    """HTML marked as a preview, and results; keeps nothing.

    Raises as `issue_certificate` does.
    """
    content = replace(
        gather_certificate(read_result_source(order.result), order), is_preview=True
    )
    html = render_certificate(content, accept_verdict=order.accept_verdict)
    return {"html": html, "results": asdict(list_main_results(content))}


def issue_certificate(order: CertificateOrder, folder: Path) -> dict[str, Any]:
    """Make a certificate, stored in a folder of its number; gives its record.

    Raises NotUsable where the result is not to be used and that was not accepted,
    BundleError for a file that does not fit.
    """
    content = gather_certificate(read_result_source(order.result), order)
    folder.mkdir(parents=True, exist_ok=True)
    count = 1 + len(list(folder.glob(f"*/{_RECORD}")))
    while True:
        numbered = replace(content, number=f"{order.stem}-{count}")
        files, record = _make_files(order, numbered)
        if _store(folder, numbered.number, files):
            return record
        count += 1


def read_certificate(folder: Path, number: str) -> dict[str, Any]:
    """The content of `certificate.json`. Raises NotFound."""
    place = _find_stored(folder).get(number)
    if place is None:
        raise NotFound(f"no certificate {number!r} is kept here")
    record: dict[str, Any] = json.loads((place / _RECORD).read_text(encoding="utf-8"))
    return record


def list_certificates(folder: Path) -> Iterator[dict[str, Any]]:
    """Records, in the order in which they were issued."""
    every = (read_certificate(folder, number) for number in _find_stored(folder))
    yield from sorted(every, key=lambda record: (record["issued_at"], record["number"]))


def get_certificate_file(
    folder: Path, number: str, form: Literal["html", "pdf"]
) -> Path:
    """Raises NotFound, and PdfUnavailable where none was made at issue."""
    name = {"html": HTML, "pdf": PDF}[form]
    if name not in read_certificate(folder, number)["files"]:
        raise PdfUnavailable(
            f"certificate {number} has no PDF: none could be made when it was issued; "
            "print its HTML, or issue another where the extra `pdf` is installed, and "
            "fonts that have every letter of it"
        )
    return folder / number / name


def _make_files(
    order: CertificateOrder, content: Certificate
) -> tuple[dict[str, bytes], dict[str, Any]]:
    html = render_certificate(content, accept_verdict=order.accept_verdict)
    files = {HTML: html.encode()}
    try:
        require_printer()
        files[PDF] = print_pdf(html)
    except PdfUnavailable:
        pass  # reported on a request for the PDF
    record = {
        "schema": "certificate/1",
        "number": content.number,
        "machine": content.found.result.machine.name,
        "issued_at": order.issued_at.isoformat(timespec="seconds"),
        "issued_by": order.issued_by,
        "language": order.language,
        "verdict": content.found.result.verdict.state,
        "verdict_accepted": order.accept_verdict,
        "identity": dict(order.identity),
        "results": asdict(list_main_results(content)),
        "sources_sha256": {name: one.sha256 for name, one in content.sources.items()},
        "files": {
            name: hashlib.sha256(data).hexdigest() for name, data in files.items()
        },
    }
    # The record last: where it exists, the others exist as well.
    return {**files, _RECORD: encode_json(record, indent=1)}, record


def _store(folder: Path, number: str, files: Mapping[str, bytes]) -> bool:
    """False if the number is taken."""
    draft = Path(tempfile.mkdtemp(prefix=".", dir=folder))
    try:
        draft.chmod(0o755)
        write_files(draft, files)
        os.rename(draft, folder / number)
    except OSError:
        if not (folder / number).exists():
            raise
        return False
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    sync_to_disk(folder)
    return True


def _find_stored(folder: Path) -> dict[str, Path]:
    places = (file.parent for file in folder.glob(f"*/{_RECORD}"))
    return {place.name: place for place in places if not place.name.startswith(".")}
