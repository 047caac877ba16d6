"""Fixtures of this room, for tests of both kinds."""

from measurement_fixtures import *  # noqa: F403
