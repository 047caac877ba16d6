"""Every installed effect keeps the contract."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.conformance import (
    CHECKS,
    NotConforming,
    effects_are_values,
    example_conditions,
    jacobian_is_the_slope_of_the_displacement,
    words_are_there,
)
from truepath.kinematics.effects.family import list_families
from truepath.kinematics.effects.servo_mismatch import ServoMismatchFamily


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("family", list_families(), ids=lambda family: family.name)
def test_an_installed_effect_conforms(family, check):
    check(family, example_conditions())


@dataclass(frozen=True)
class Crooked(Effect):
    """Its displacement is not what its Jacobian says."""

    kind = "crooked"
    units = {"": "mm"}  # noqa: RUF012 (declared as ClassVar in Effect)

    def jacobian(self, at):
        return columns_along("X", np.ones((len(at), 1)))

    def displacement_mm(self, at, theta):
        return 2.0 * super().displacement_mm(at, theta)


class CrookedFamily(ServoMismatchFamily):
    keys = {}  # noqa: RUF012 (declared as ClassVar in Family)
    words = {"en": ServoMismatchFamily.words["en"]}  # noqa: RUF012

    def propose(self, at):
        return [self.offer(Crooked(), [1.0]), self.offer(Crooked(), [1.0])]


@pytest.mark.parametrize(
    ("check", "complaint"),
    [
        (jacobian_is_the_slope_of_the_displacement, "is not the slope"),
        (effects_are_values, "share names"),
        (words_are_there, "no words in de"),
    ],
)
def test_an_effect_that_breaks_the_contract_is_told_so(check, complaint):
    with pytest.raises(NotConforming, match=complaint):
        check(CrookedFamily(), example_conditions())


def test_a_family_that_proposes_nothing_is_not_checked_silently():
    at = replace(example_conditions(), recorded=None)
    with pytest.raises(NotConforming, match="proposes nothing"):
        words_are_there(ServoMismatchFamily(), at)
