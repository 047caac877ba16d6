"""Fixtures of this room, for tests of both kinds."""

from planning_fixtures import *  # noqa: F403
