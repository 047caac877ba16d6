from results_fixtures import *  # noqa: F403
