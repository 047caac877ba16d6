"""Fixtures of this room, for tests of both kinds."""

from project_fixtures import *  # noqa: F403
