"""The reports are of the estimates that the tests of results construct."""

from results_fixtures import *  # noqa: F403
