"""Fixtures of this room, for tests of both kinds."""

from service_fixtures import *  # noqa: F403
