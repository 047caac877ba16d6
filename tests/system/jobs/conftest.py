"""Fixtures of this room, for tests of both kinds."""

from jobs_fixtures import *  # noqa: F403
