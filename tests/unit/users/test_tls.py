"""Certificates: made for names, and checked before anybody listens."""

import os
import ssl
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest

from truepath.errors import BadInput
from truepath.users.tls import TlsFiles, check_tls_files, create_certificate


@pytest.fixture
def files(tmp_path):
    return create_certificate(["localhost", "127.0.0.1"], tmp_path / "tls", days=30)


def test_one_that_was_made_holds_for_its_days_and_is_not_written_over(files, tmp_path):
    now = datetime.now(UTC)
    assert timedelta(days=29) < check_tls_files(files) - now < timedelta(days=30)
    assert os.stat(files.key).st_mode & 0o777 == 0o600
    for days, said in ((31, "expired on"), (-2, "check the clock of this computer")):
        with pytest.raises(BadInput, match=said):
            check_tls_files(files, now + timedelta(days=days))
    with pytest.raises(BadInput, match="is there already"):
        create_certificate(["localhost"], files.cert.parent, days=1)
    for name in ("", "a b", "https://a", "ä"):
        with pytest.raises(BadInput, match="is no name of a computer"):
            create_certificate([name], tmp_path, days=1)


def test_files_that_cannot_be_used_are_named_by_their_setting(files, tmp_path):
    other = create_certificate(["other"], tmp_path / "other", days=30)
    absent, text = tmp_path / "absent.pem", tmp_path / "text.pem"
    text.write_text("no certificate")
    wrong = {
        r"tls_cert .*absent.pem\): cannot be read: No such": (absent, files.key),
        r"tls_cert .*text.pem\): is no certificate": (text, files.key),
        r"tls_key .*absent.pem\): cannot be read": (files.cert, absent),
        r"tls_key .*text.pem\): is no unencrypted": (files.cert, text),
        r"tls_key .*other/key.pem\): is no unencrypted": (files.cert, other.key),
    }
    for said, (cert, key) in wrong.items():
        with pytest.raises(BadInput, match=said):
            check_tls_files(TlsFiles(cert, key))


def shake_hands(files, trusted, name):
    """Open TLS as a client of a service with these files; return its version."""
    to_client, to_service = ssl.MemoryBIO(), ssl.MemoryBIO()
    here = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    here.load_cert_chain(files.cert, files.key)
    there = ssl.create_default_context(cafile=trusted)
    service = here.wrap_bio(to_service, to_client, server_side=True)
    client = there.wrap_bio(to_client, to_service, server_hostname=name)
    for end in (client, service, client, service):
        with suppress(ssl.SSLWantReadError):
            end.do_handshake()
    return client.version()


def test_a_client_that_trusts_it_is_answered_and_no_other(files):
    for name in ("localhost", "127.0.0.1"):
        assert shake_hands(files, files.cert, name) == "TLSv1.3"
    for trusted, name in ((None, "localhost"), (files.cert, "other")):
        with pytest.raises(ssl.SSLCertVerificationError):
            shake_hands(files, trusted, name)
