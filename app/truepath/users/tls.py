"""TLS: certificates are checked before the service listens, and can be made here."""

from __future__ import annotations

import ipaddress
import os
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from truepath.errors import BadInput


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Certificate and key, PEM files that belong together."""

    cert: Path
    key: Path


def check_tls_files(files: TlsFiles, now: datetime | None = None) -> datetime:
    """End of validity of the certificate.

    Raises BadInput if a file cannot be read, they do not belong together, or the
    certificate is not valid now.
    """
    cert = _read_certificate(files.cert)
    _read(files.key, "tls_key")
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        # Asked for a password at the terminal, a service would wait for ever.
        context.load_cert_chain(files.cert, files.key, password="")
    except (ssl.SSLError, ValueError) as error:
        raise BadInput(
            f"setting tls_key ({files.key}): is no unencrypted PEM key of the "
            f"certificate {files.cert}; give the key it was made with"
        ) from error
    moment = now or datetime.now(UTC)
    begin, end = cert.not_valid_before_utc, cert.not_valid_after_utc
    if moment > end:
        raise BadInput(
            f"setting tls_cert ({files.cert}): expired on {end:%Y-%m-%d}; renew it"
        )
    if moment < begin:
        raise BadInput(
            f"setting tls_cert ({files.cert}): holds from {begin:%Y-%m-%d} only, and "
            f"it is {moment:%Y-%m-%d}; check the clock of this computer"
        )
    return end


def create_certificate(names: Sequence[str], folder: Path, days: int) -> TlsFiles:
    """Make a self-signed certificate for names or addresses, with its key, in a folder.

    Raises BadInput for an invalid name, or if there is one already.
    """
    files = TlsFiles(folder / "cert.pem", folder / "key.pem")
    for file in (files.cert, files.key):
        if file.exists():
            raise BadInput(f"{file}: is there already; move it away first")
    subjects = [_parse_name(name) for name in names]
    key = ec.generate_private_key(ec.SECP256R1())
    begin = datetime.now(UTC) - timedelta(hours=1)  # other clocks may be behind
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, names[0][:64])])
    cert = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(begin + timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName(subjects), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    folder.mkdir(parents=True, exist_ok=True)
    kept = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    with open(
        os.open(files.key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb"
    ) as f:
        f.write(kept)
    files.cert.write_bytes(cert.public_bytes(serialization.Encoding.PEM))
    return files


def _parse_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        pass
    try:
        if not name or set(name) & set(" /:@"):
            raise ValueError
        return x509.DNSName(name)
    except ValueError as error:
        raise BadInput(f"{name!r} is no name of a computer and no address") from error


def _read_certificate(file: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(_read(file, "tls_cert"))
    except ValueError as error:
        raise BadInput(
            f"setting tls_cert ({file}): is no certificate in PEM; convert it"
        ) from error


def _read(file: Path, setting: str) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise BadInput(
            f"setting {setting} ({file}): cannot be read: {error.strerror}; check the "
            "name, and who may read it"
        ) from error
