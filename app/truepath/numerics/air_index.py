"""Refractive index of moist air, of the phase and of a group of waves.

P. E. Ciddor, Appl. Opt. 35 (1996) 1566-1573, constants of appendix A and B; group index
after Ciddor and Hill, Appl. Opt. 38 (1999) 1663-1667: each term of the dispersion
f(σ) becomes d(σ f)/dσ. Good to 5e-8 from 300 to 1690 nm in the air of a workshop.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

_GAS = 8.314510  # J/(mol K)
_CO2_PPM = 450.0
_DRY = ((238.0185, 5792105.0), (57.362, 167917.0))  # µm⁻²
_VAPOUR = (295.235, 2.6422, -0.032380, 0.004028)  # µm⁰, µm², µm⁴, µm⁶
_MOLE_WATER_KG = 0.018015
_MOLE_DRY_KG = 1e-3 * (28.9635 + 12.011e-6 * (_CO2_PPM - 400.0))

Numbers = Float64[np.ndarray, " n"]


def compute_air_index(
    wavelength_nm: float,
    temperature_degc: Numbers,
    pressure_hpa: Numbers,
    humidity_percent: Numbers,
    *,
    is_group: bool,
) -> Numbers:
    """Index of air with 450 ppm of CO₂.

    is_group : of modulated light (ADM, EDM), else of the phase (fringes of an IFM)
    """
    kelvin, pascal = temperature_degc + 273.15, 100.0 * pressure_hpa
    water = _compute_water_share(kelvin, pascal, 0.01 * humidity_percent)
    dry, vapour = _compute_dispersion((1e3 / wavelength_nm) ** 2, is_group=is_group)
    amount = pascal / (_compute_compressibility(kelvin, pascal, water) * _GAS * kelvin)
    density = amount * _MOLE_DRY_KG * (1.0 - water)
    wet_density = amount * _MOLE_WATER_KG * water
    at_air = _compute_density(288.15, 101325.0, 0.0, _MOLE_DRY_KG)
    at_vapour = _compute_density(293.15, 1333.0, 1.0, _MOLE_WATER_KG)
    return 1.0 + density / at_air * dry + wet_density / at_vapour * vapour


def compute_site_pressure_hpa(altitude_m: float) -> float:
    """Pressure of the standard atmosphere at an altitude."""
    return 1013.25 * (1.0 - 2.25577e-5 * altitude_m) ** 5.25588


def _compute_dispersion(square: float, *, is_group: bool) -> tuple[float, float]:
    """Refractivity n − 1 of standard air and vapour at a squared wave number, µm⁻²."""
    dry = sum(
        scale * (pole + square) / (pole - square) ** 2
        if is_group
        else scale / (pole - square)
        for pole, scale in _DRY
    )
    vapour = sum(
        (2 * k + 1 if is_group else 1) * factor * square**k
        for k, factor in enumerate(_VAPOUR)
    )
    return 1e-8 * dry, 1.022e-8 * vapour


def _compute_water_share(
    kelvin: Numbers, pascal: Numbers, humidity: Numbers
) -> Numbers:
    saturated = np.exp(
        1.2378847e-5 * kelvin**2
        - 1.9121316e-2 * kelvin
        + 33.93711047
        - 6.3431645e3 / kelvin
    )
    enhanced = 1.00062 + 3.14e-8 * pascal + 5.6e-7 * (kelvin - 273.15) ** 2
    return enhanced * humidity * saturated / pascal


def _compute_compressibility(
    kelvin: Numbers, pascal: Numbers, water: Numbers
) -> Numbers:
    t, ratio = kelvin - 273.15, pascal / kelvin
    first = (
        1.58123e-6
        - 2.9331e-8 * t
        + 1.1043e-10 * t**2
        + (5.707e-6 - 2.051e-8 * t) * water
        + (1.9898e-4 - 2.376e-6 * t) * water**2
    )
    return 1.0 - ratio * first + ratio**2 * (1.83e-11 - 0.765e-8 * water**2)


def _compute_density(
    kelvin: float, pascal: float, water: float, mole_kg: float
) -> float:
    one = np.ones(1)
    compressed = float(
        _compute_compressibility(kelvin * one, pascal * one, water * one)[0]
    )
    return pascal * mole_kg / (compressed * _GAS * kelvin)
