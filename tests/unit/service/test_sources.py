"""Whom a request comes from where a proxy says so."""

from dataclasses import replace

import pytest
from starlette.testclient import TestClient

from truepath.service.api.application import create_application
from truepath.users.roles import Role

PASSWORD = "a long sentence is easy"
SESSION = "/api/v1/session"


@pytest.fixture
def access(access):
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    return access


def log_in(client, password, **headers):
    body = {"name": "anna", "password": password}
    return client.post(SESSION, json=body, headers=headers).status_code


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


def test_a_house_of_ipv6_addresses_is_one_source_that_waits_at_length(service, access):
    app = create_application(replace(service, access=access))
    body, answers = {"name": "anna", "password": "wrong"}, []
    for n in range(1, 7):
        client = (f"2001:db8::{n}", 5)
        with TestClient(app, base_url="http://127.0.0.1", client=client) as one:
            answers.append(one.post(SESSION, json=body))
    assert [answer.status_code for answer in answers] == [401] * 5 + [429]
    assert int(answers[-1].headers["Retry-After"]) >= 1
    assert answers[-1].json()["code"] == "too-many-tries"
