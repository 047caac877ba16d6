"""Dry and wet temperature, between which an instrument states the humidity.

R. Stull, J. Appl. Meteorol. Climatol. 50 (2011) 2267-2269: good to 1 K from 5 % to
99 % and -20 to 50 °C, which is 0.02 ppm of a distance.
"""

from __future__ import annotations

import math


def find_wet_bulb(dry_degc: float, humidity_percent: float) -> float:
    """Return the temperature of a wet thermometer near sea level."""
    t, rh = dry_degc, humidity_percent
    return (
        t * math.atan(0.151977 * math.sqrt(rh + 8.313659))
        + math.atan(t + rh)
        - math.atan(rh - 1.676331)
        + 0.00391838 * rh**1.5 * math.atan(0.023101 * rh)
        - 4.686035
    )


def find_humidity(dry_degc: float, wet_degc: float) -> float:
    """Return the humidity in % at which a wet thermometer shows so much."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if find_wet_bulb(dry_degc, middle) < wet_degc:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
