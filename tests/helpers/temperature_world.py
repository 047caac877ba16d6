"""Results of a machine that depends on temperature in a known way."""

import numpy as np

from truepath.answers.temperature import ResultAtTemperature
from truepath.files.earlier.result_file import CalibrationResult
from truepath.results.error_tables import choose_table_positions

DEGC = (18.0, 25.0, 20.0, 22.0)
SHIFTED = "EXX"


class World:
    """A machine with a true line, and results drawn about it."""

    def __init__(self, estimate, share):
        """share : of the covariance of the estimate, that of each result"""
        self.estimate = estimate
        self.model = estimate.model
        self.covariance = share * estimate.covariance
        self.root = np.sqrt(share) * np.linalg.cholesky(estimate.covariance)
        self.coefficient = np.zeros(self.model.size)

    def grow(self, um_per_m_k):
        """X grows: the straight shape of its positioning."""
        motion = next(m for m in self.model.identifiable_motions if m.symbol == SHIFTED)
        at_mm = choose_table_positions(motion.axis)
        wanted_mm = 1e-6 * um_per_m_k * at_mm
        found = np.linalg.lstsq(motion.rows(at_mm), wanted_mm, rcond=None)[0]
        self.coefficient[self.model.slices[SHIFTED]] = found
        return self

    def draw(self, seed, degc=DEGC, *, sigma_k=0.1, scatter=0.0, times=None):
        """Results at temperatures; scatter is of EXX, in its standard uncertainties."""
        rng = np.random.default_rng(seed)
        found = []
        for k, celsius in enumerate(degc):
            off = self.root @ rng.standard_normal(self.model.size)
            off[self.model.slices[SHIFTED]] *= np.hypot(1.0, scatter)
            theta = self.estimate.theta + (celsius - 20.0) * self.coefficient + off
            runs = [{"name": f"{k}", "input_sha256": f"{seed}-{k}"}]
            told = self.model, theta, self.covariance
            result = CalibrationResult(*told, provenance={"runs": runs})
            shown = celsius + sigma_k * rng.standard_normal()
            time_s = None if times is None else times[k]
            found.append(ResultAtTemperature(f"r{k}", result, shown, sigma_k, time_s))
        return found
