"""Fixtures of this room, for tests of both kinds."""

from drivers_fixtures import *  # noqa: F403
