from jobs_fixtures import logged_plainly, make_cell, science  # noqa: F401
from service_fixtures import *  # noqa: F403
