from jobs_fixtures import *  # noqa: F403
