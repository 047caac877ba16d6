from project_fixtures import *  # noqa: F403
