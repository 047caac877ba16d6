"""The scripts of `validation/`, as tests of one process import them."""

from tests.unit.validation.conftest import *  # noqa: F403
