"""pytest fixtures: simulated devices for tests of any software.

Loaded by pytest wherever Truepath is installed; it costs nothing until a test uses it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from truepath_simulators.bench.rig import Rig

_OPTION = "--truepath-control"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("truepath")
    text = "control socket of a running `truepath simulate`, in place of fresh rigs"
    group.addoption(_OPTION, metavar="PATH", default="", help=text)


def pytest_configure(config: pytest.Config) -> None:
    text = "truepath_bench(**options): options of `truepath simulate` for the fixture"
    config.addinivalue_line("markers", text)


@pytest.fixture
def truepath_bench(
    request: pytest.FixtureRequest, start_truepath_bench: Callable[..., Rig]
) -> Rig:
    """A simulated machine with its tracker, fresh for each test.

    The marker `truepath_bench(seed=3, speed=5.0)` sets its options.
    """
    marker = request.node.get_closest_marker("truepath_bench")
    return start_truepath_bench(**(marker.kwargs if marker else {}))


@pytest.fixture
def start_truepath_bench(
    request: pytest.FixtureRequest,
) -> Iterator[Callable[..., Rig]]:
    """Factory of rigs by their options; they end with the test."""
    with ExitStack() as stack:
        yield _starter(request.config, stack)


@pytest.fixture(scope="session")
def start_lasting_truepath_bench(
    request: pytest.FixtureRequest,
) -> Iterator[Callable[..., Rig]]:
    """Factory of rigs by their options; they end with the session."""
    with ExitStack() as stack:
        yield _starter(request.config, stack)


def _starter(config: pytest.Config, stack: ExitStack) -> Callable[..., Rig]:
    from truepath_simulators.bench.rig import Rig, running_rig

    def start(**options: Any) -> Rig:
        control = config.getoption(_OPTION)
        if not control:
            return stack.enter_context(running_rig(options))
        if options:
            pytest.skip(f"needs a rig of its own: {options}")
        return stack.enter_context(closing(Rig(control)))

    return start
