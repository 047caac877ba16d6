"""CNCs behind registers, within the test's process."""

from collections.abc import Iterator

import pytest

from register_peers import PEERS, ModbusPeer, RtuPeer, TcpPeer


@pytest.fixture(params=list(PEERS))
def peer(request) -> Iterator[ModbusPeer]:
    with PEERS[request.param]() as peer:
        yield peer


@pytest.fixture
def rtu_peer() -> Iterator[RtuPeer]:
    with RtuPeer() as peer:
        yield peer


@pytest.fixture
def tcp_peer() -> Iterator[TcpPeer]:
    with TcpPeer() as peer:
        yield peer
