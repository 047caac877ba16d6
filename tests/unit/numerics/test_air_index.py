"""Ciddor's index of air against values that others have published."""

import numpy as np
import pytest

from truepath.numerics.air_index import compute_air_index


def index_of(wavelength_nm, degc, hpa, percent, *, is_group=False):
    state = (np.array([float(value)]) for value in (degc, hpa, percent))
    return float(compute_air_index(wavelength_nm, *state, is_group=is_group)[0])


@pytest.mark.parametrize(
    ("wavelength_nm", "degc", "hpa", "percent", "published"),
    [  # the calculator of NIST's engineering metrology toolbox, Ciddor, 450 ppm of CO2
        (321.456, 20, 1013.25, 50, 1.000283543),
        (500.0, 20, 1013.25, 50, 1.000273781),
        (633.0, 20, 1013.25, 50, 1.000271373),
        (700.0, 20, 1013.25, 50, 1.000270657),
        (1000.987, 20, 1013.25, 50, 1.000269038),
        (1500.8, 20, 1013.25, 50, 1.000268190),
        (633.0, 20, 1013.25, 0, 1.000271800),
        (633.0, 0, 1013.25, 0, 1.000291767),
        (633.0, 40, 1013.25, 0, 1.000254398),
        (633.0, 20, 500.0, 0, 1.000134099),
        (633.0, 20, 1200.0, 0, 1.000321916),
    ],
)
def test_the_phase_index_is_that_of_nist(wavelength_nm, degc, hpa, percent, published):
    found = index_of(wavelength_nm, degc, hpa, percent)
    assert found == pytest.approx(published, abs=1.1e-9)


@pytest.mark.parametrize("wavelength_nm", [670.0, 780.0, 850.0, 1310.0])
def test_the_group_index_is_that_of_the_geodesists(wavelength_nm):
    """IUGG 1999, resolution 3: dry air at 0 °C, 1013.25 hPa, 375 ppm of CO2."""
    um = 1e-3 * wavelength_nm
    ppm = 287.6155 + 4.88660 / um**2 + 0.06800 / um**4
    found = 1e6 * (index_of(wavelength_nm, 0, 1013.25, 0, is_group=True) - 1.0)
    assert found == pytest.approx(ppm, abs=0.03)  # 75 ppm of CO2 are 0.012


@pytest.mark.parametrize("percent", [0.0, 80.0])
def test_the_group_index_is_that_of_its_definition(percent):
    wavelength_nm, step_nm = 780.0, 0.01
    light_nm = wavelength_nm + step_nm, wavelength_nm - step_nm
    ends = [index_of(one, 25, 990, percent) for one in light_nm]
    slope = (ends[0] - ends[1]) / (2 * step_nm)
    expected = index_of(wavelength_nm, 25, 990, percent) - wavelength_nm * slope
    group = index_of(wavelength_nm, 25, 990, percent, is_group=True)
    assert group == pytest.approx(expected, abs=2e-11)
