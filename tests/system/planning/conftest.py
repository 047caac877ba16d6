from planning_fixtures import *  # noqa: F403
