"""Fixtures of this room, for tests of both kinds."""

from answers_fixtures import *  # noqa: F403
