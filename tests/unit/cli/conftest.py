"""Fixtures of this room, for tests of both kinds."""

from cli_fixtures import *  # noqa: F403
