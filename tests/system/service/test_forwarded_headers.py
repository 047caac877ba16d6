"""Whom a request comes from: what a proxy says of it, and who is one."""

import time

import httpx2
import pytest

from serving import serving
from truepath.users.roles import Role

PASSWORD = "a long sentence is easy"
SESSION = "/api/v1/session"


@pytest.fixture
def access(access):
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    return access


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
        forged = [
            {"X-Forwarded-For": f"198.51.100.{n}", "Forwarded": "for=192.0.2.1"}
            for n in range(8)
        ]
        found = [log_in(client, "wrong", **headers) for headers in forged]
    assert found == [401] * 5 + [429] * 3
    assert set(read_sources(access)) == {"127.0.0.1"}


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
