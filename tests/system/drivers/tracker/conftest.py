"""A tracker that streams, on either kind of wire."""

from collections.abc import Iterator

import pytest

from tracker_peers import LoopbackTracker
from wires import WIRES, Wire


@pytest.fixture(params=list(WIRES))
def wire(request) -> Iterator[Wire]:
    wire = WIRES[request.param]()
    yield wire
    wire.unplug()


@pytest.fixture
def peer(wire) -> Iterator[LoopbackTracker]:
    with LoopbackTracker(wire) as peer:
        yield peer
