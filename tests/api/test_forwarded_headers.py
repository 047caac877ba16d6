"""Whom a request comes from: what a proxy says of it, and who is one."""

from __future__ import annotations

import time
from dataclasses import replace

import httpx2
import pytest
from serving import serving
from starlette.testclient import TestClient

from truepath.service.api.application import create_application
from truepath.users.access import Access, AccessRules
from truepath.users.roles import Role

LOOPBACK = "127.0.0.1"
PASSWORD = "a long sentence is easy"
SESSION = "/api/v1/session"


@pytest.fixture
def access(service):
    access = Access(service.database, AccessRules(log_in_required=True))
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    yield access
    access.close()


def address(place):
    return "http://{}:{}".format(*place)


def log_in(client, password, **headers):
    body = {"name": "anna", "password": password}
    return client.post(SESSION, json=body, headers=headers).status_code


def read_sources(access):
    access.close()  # writes what waits
    return [row.entry.source for row in access.audit_log.read()]


@pytest.mark.fault_row(47)
def test_a_forged_forwarded_address_neither_spares_the_wait_nor_hides_the_source(
    service, access
):
    with (
        serving(service, access) as place,
        httpx2.Client(base_url=address(place), timeout=10.0) as client,
    ):
        found = [
            log_in(
                client,
                "wrong",
                **{"X-Forwarded-For": f"198.51.100.{n}", "Forwarded": "for=192.0.2.1"},
            )
            for n in range(8)
        ]
    assert found == [401] * 5 + [429] * 3
    assert set(read_sources(access)) == {LOOPBACK}


def test_a_name_that_fails_from_everywhere_waits_for_two_seconds_at_most(
    service, access
):
    def log_in_from(source, password):
        way = httpx2.HTTPTransport(local_address=source)
        begun = time.monotonic()
        with httpx2.Client(
            base_url=address(place), transport=way, timeout=10.0
        ) as client:
            status = log_in(client, password)
        return status, time.monotonic() - begun

    with serving(service, access) as place:
        for number in range(2, 8):
            assert log_in_from(f"127.0.0.{number}", "wrong")[0] == 401
        status, took_s = log_in_from("127.0.0.8", PASSWORD)
    assert status == 200, "nobody keeps another person out"
    assert 0.5 < took_s < 4.0


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
def test_the_last_stranger_that_trusted_proxies_name_is_the_source(
    service, access, peer, forwarded, source
):
    app = create_application(
        replace(service, access=access), trusted_proxies=["127.0.0.1", "10.0.0.0/8"]
    )
    with TestClient(app, base_url="http://127.0.0.1", client=(peer, 5)) as client:
        log_in(client, "wrong", **{"X-Forwarded-For": forwarded})
    (shown,) = read_sources(access)
    assert shown.startswith(source)
    assert ("via" in shown) == (shown.split(" ")[0] != peer)


def test_a_house_of_ipv6_addresses_is_one_source(service, access):
    app = create_application(replace(service, access=access))
    found = []
    for n in range(1, 7):
        client = (f"2001:db8::{n}", 5)
        with TestClient(app, base_url="http://127.0.0.1", client=client) as one:
            found.append(log_in(one, "wrong"))
    assert found == [401] * 5 + [429]
