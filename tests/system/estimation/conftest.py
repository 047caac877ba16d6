"""Fixtures of this room, for tests of both kinds."""

from estimation_fixtures import *  # noqa: F403
