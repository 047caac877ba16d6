"""docs/discovery.md lists what the code looks for, in its own words."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from truepath.discovery.discover import align_runs
from truepath.kinematics.effects.error_motion import Squareness
from truepath.kinematics.effects.family import CandidateEstimate, list_families
from truepath.kinematics.effects.thermal_growth import WarmingUp
from truepath.kinematics.model import restore_effect
from truepath.service.page.pages import LANGUAGES, catalogue

UNIT = re.compile(
    r"_(um_per_m_K|um_per_m|um_per_s|urad_per_m|ppm_per_K|ppm_per_s"
    r"|urad|rad|um|mm|ms|hz|s)$"
)
DOCS = Path(__file__).parents[3] / "docs"
CONTRACT = (
    *("backlash", "lateral-backlash", "screw-cyclic", "thermal-growth", "table-drift"),
    *("elastic-sag", "servo-mismatch", "reversal-spike", "squareness", "vibration"),
    *("tracker-eccentricity", "tracker-range-offset", "setup-step"),
)


@pytest.fixture(scope="module")
def at(record):
    return align_runs([record(11, rows=40, travel_mm=150.0)[0]])[0].at


def test_the_catalogue_of_the_page_is_that_of_the_code():
    script = runpy.run_path(str(DOCS / "write_tables.py"))
    assert not script["main"](["effects"], check=True), "docs/write_tables.py"


def test_every_effect_of_the_contract_is_installed_and_explained():
    known = {family.name: family.words["en"] for family in list_families()}
    for name in CONTRACT:
        words = known[name]
        for sentence in (words.cause, words.looks_like, words.remedy):
            assert sentence.endswith("."), (name, sentence)


@pytest.mark.parametrize("family", list_families(), ids=lambda f: f.name)
def test_an_effect_of_the_machine_is_made_again_from_keys_and_numbers(family, at):
    for candidate in family.propose(at):
        numbers = family.list_numbers(candidate)
        again = restore_effect(family, at.machine, candidate.keys, numbers)
        if not family.is_kept or isinstance(candidate.effect, WarmingUp):
            assert again is None
            continue
        assert again is not None
        made = candidate.effect.jacobian(at)
        np.testing.assert_array_equal(again.jacobian(at), made)
        is_square = isinstance(candidate.effect, Squareness)
        assert (again.name == candidate.label) or is_square or numbers


@pytest.mark.parametrize("family", list_families(), ids=lambda f: f.name)
def test_every_number_of_an_effect_has_a_name_on_the_page(family, at):
    few = at.select(np.arange(0, len(at), 25))  # names do not depend on the data
    for candidate in family.propose(few):
        size = len(candidate.prior_sigma)
        found = CandidateEstimate(candidate, np.ones(size), np.eye(size), 1.0)
        for name in family.state(found):
            whole = UNIT.sub("", name.partition("[")[0])
            for language in LANGUAGES:
                assert f"parameter.{whole}" in catalogue(language), name
