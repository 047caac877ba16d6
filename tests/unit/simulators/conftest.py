"""Fixtures of this room, for tests of both kinds."""

from simulators_fixtures import *  # noqa: F403
