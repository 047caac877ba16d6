"""Whom a request comes from: what a proxy says of it, and who is one."""

import time
from dataclasses import replace

import httpx2
import pytest
from starlette.testclient import TestClient

from serving import serving
from truepath.service.api.application import create_application
from truepath.users.roles import Role

PASSWORD = "a long sentence is easy"


@pytest.fixture
def access(access):
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    return access


def log_in(client, password="wrong", **headers):
    body = {"name": "anna", "password": password}
    return client.post("/api/v1/session", json=body, headers=headers)


def read_sources(access):
    access.close()  # writes what waits
    return [row.entry.source for row in access.audit_log.read()]


@pytest.mark.parametrize(
    ("peer", "forwarded", "source"),
    [
        ("192.0.2.9", "198.51.100.1", "192.0.2.9"),
        ("127.0.0.1", "198.51.100.1", "198.51.100.1 via 127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, 198.51.100.1", "198.51.100.1 via 127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, 198.51.100.1:99, 10.1.2.3", "198.51.100.1"),
        ("127.0.0.1", "1.1.1.1, nonsense", "127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, nonsense, 10.1.2.3", "10.1.2.3 via 127.0.0.1"),
        ("127.0.0.1", "[2001:db8::0:1]:443", "2001:db8::1 via 127.0.0.1"),
        ("::ffff:10.0.0.7", "::ffff:198.51.100.1", "198.51.100.1 via ::ffff:10.0.0.7"),
        ("127.0.0.1", "", "127.0.0.1"),
    ],
)
def test_a_source_is_the_last_stranger_named(service, access, peer, forwarded, source):
    proxies = ["127.0.0.1", "10.0.0.0/8"]
    app = create_application(replace(service, access=access), trusted_proxies=proxies)
    with TestClient(app, base_url="http://127.0.0.1", client=(peer, 5)) as client:
        log_in(client, **{"X-Forwarded-For": forwarded})
    (shown,) = read_sources(access)
    assert shown.startswith(source)
    assert ("via" in shown) == (shown.split(" ")[0] != peer)


def test_a_house_of_ipv6_addresses_is_one_source_that_waits_at_length(service, access):
    app, answers = create_application(replace(service, access=access)), []
    for n in range(1, 7):
        client = (f"2001:db8::{n}", 5)
        with TestClient(app, base_url="http://127.0.0.1", client=client) as one:
            answers.append(log_in(one))
    assert [answer.status_code for answer in answers] == [401] * 5 + [429]
    assert int(answers[-1].headers["Retry-After"]) >= 1
    assert answers[-1].json()["code"] == "too-many-tries"


@pytest.fixture
def reach(service, access):
    """Make clients of the service over a real socket, each from an address."""
    with serving(service, access) as (host, port):

        def make(source):
            way = httpx2.HTTPTransport(local_address=source)
            address = f"http://{host}:{port}"
            return httpx2.Client(base_url=address, transport=way, timeout=10.0)

        yield make


@pytest.mark.fault_row(47)
def test_a_forged_address_spares_no_wait_and_hides_no_source(reach, access):
    with reach("127.0.0.1") as client:
        found = []
        for n in range(8):
            forged = {
                "X-Forwarded-For": f"198.51.100.{n}",
                "Forwarded": "for=192.0.2.1",
            }
            found.append(log_in(client, **forged).status_code)
    assert found == [401] * 5 + [429] * 3
    assert set(read_sources(access)) == {"127.0.0.1"}


def test_a_name_that_fails_from_everywhere_waits_for_two_seconds_at_most(reach):
    for number in range(2, 8):
        with reach(f"127.0.0.{number}") as client:
            assert log_in(client).status_code == 401
    begun = time.monotonic()
    with reach("127.0.0.8") as client:
        answer = log_in(client, PASSWORD)
    assert answer.status_code == 200, "nobody keeps another person out"
    assert 0.5 < time.monotonic() - begun < 4.0
