"""Fixtures of this room, for tests of both kinds."""

from results_fixtures import *  # noqa: F403
