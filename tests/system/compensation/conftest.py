"""Fixtures of this room, for tests of both kinds."""

from compensation_fixtures import *  # noqa: F403
