from estimation_fixtures import *  # noqa: F403
