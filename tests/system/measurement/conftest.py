from measurement_fixtures import *  # noqa: F403
