"""A recording through the product, and its estimate judged by the exact truth.

The volume is the whole axis travel, by Gauss–Legendre points with their weights; the
rigid motion of the whole volume, which no tracker can tell from where it stands, is
removed from truth and estimate alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from recordings import run_of

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.estimation.solve.batch import Estimate, estimate
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.error_tables import choose_table_positions
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.worlds.recording import Recording

_NODES = 12


@dataclass(frozen=True)
class Volume:
    """Points that stand for the whole travel, with weights that sum to 1."""

    machine: Machine
    position_mm: np.ndarray
    weight: np.ndarray

    def rigid_free(self, error_mm: np.ndarray) -> np.ndarray:
        """Return errors (n, 3) without the rigid motion of the whole volume."""
        columns = np.zeros((len(self.weight), 3, 6))
        columns[:, :, :3] = np.eye(3)
        centred = self.position_mm - self.weight @ self.position_mm
        for k, axis in enumerate(np.eye(3)):
            columns[:, :, 3 + k] = np.cross(axis, centred)
        root = np.sqrt(self.weight)[:, None]
        flat = (columns * root[:, :, None]).reshape(-1, 6)
        fit = np.linalg.lstsq(flat, (error_mm * root).reshape(-1), rcond=None)[0]
        return error_mm - columns @ fit

    def mean_length(self, error: np.ndarray) -> float:
        """Return the mean length of vectors (n, 3): the papers' mean absolute error."""
        return float(self.weight @ np.linalg.norm(error, axis=1))

    def rms_length(self, error: np.ndarray) -> float:
        """Return the root mean square length of vectors (n, 3)."""
        return float(np.sqrt(self.weight @ (error**2).sum(axis=1)))

    def share(self, true: np.ndarray) -> float:
        """Return the share of the volume's components (n, 3) that are true."""
        return float(self.weight @ true.mean(axis=1))


def volume(machine: Machine) -> Volume:
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    low = np.array([a.low for a in machine.linear_axes])
    high = np.array([a.high for a in machine.linear_axes])
    unit = np.stack([g.ravel() for g in np.meshgrid(*[node] * 3, indexing="ij")], 1)
    product = np.prod(np.meshgrid(*[weight] * 3, indexing="ij"), axis=0).ravel()
    position = low + (unit + 1.0) / 2.0 * (high - low)
    return Volume(machine, position, product / product.sum())


def true_map_mm(within: Volume, truth: TruthMachine) -> np.ndarray:
    """Return the truth's map without its rigid motion, by exact transforms."""
    return within.rigid_free(truth.deviation_mm(within.position_mm))


def map_mm(
    within: Volume, model: MachineModel, theta: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a model's volumetric error and its standard uncertainty, (n, 3) each."""
    at = make_standstill(within.machine, within.position_mm)
    found = build_volumetric_map(model)
    return found.error_mm(at, theta), found.sigma_mm(at, covariance)


def true_parameters(model: MachineModel, truth: TruthMachine) -> np.ndarray:
    """Return the parameters of a model that make the truth's map, gauge included.

    With one target some error motions merge into others, which are the truth that a
    table can hold; themselves they are 0. The spline's own misfit is far below a
    tracker's noise.
    """
    rng = np.random.default_rng(0)
    low = np.array([a.low for a in model.machine.linear_axes])
    high = np.array([a.high for a in model.machine.linear_axes])
    inside = rng.uniform(low, high, (3000, 3))
    ends = low + rng.integers(0, 2, (300, 3)) * (high - low)
    edges = np.where(rng.uniform(size=(300, 3)) < 0.5, ends, inside[:300])
    position = np.vstack([inside, edges])
    columns = model.jacobian(make_standstill(model.machine, position))
    for name in model.confounded:
        columns[:, :, model.slices[name]] = 0.0
    rigid = np.zeros((len(position), 3, 6))
    rigid[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        rigid[:, :, 3 + k] = np.cross(axis, position - position.mean(axis=0)) / 500.0
    both = np.concatenate([columns, rigid], axis=2).reshape(-1, model.size + 6)
    scale = np.linalg.norm(both, axis=0)
    scale[scale == 0.0] = 1.0  # what moves nothing where the machine stands
    fit = np.linalg.lstsq(
        both / scale, truth.deviation_mm(position).reshape(-1), rcond=None
    )[0]
    return (fit / scale)[: model.size]


def table_deviations(
    model: MachineModel, theta: np.ndarray, covariance: np.ndarray, truth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return estimate − truth, its uncertainty and a number for each motion.

    Over all table values that are not fixed by their gauge, squarenesses included;
    motions that the target does not tell from others are left out.
    """
    off, sigma, group = [], [], []
    for number, effect in enumerate(model.effects):
        if effect.name in model.confounded:
            continue
        part = model.slices[effect.name]
        rows = np.eye(part.stop - part.start)
        if isinstance(effect, ErrorMotion):
            rows = effect.rows(choose_table_positions(effect.axis))
        free = np.linalg.norm(rows, axis=1) > 1e-9
        off.append((rows @ (theta - truth)[part])[free])
        variance = np.einsum("np,np->n", rows @ covariance[part, part], rows)
        sigma.append(np.sqrt(np.maximum(variance, 0.0))[free])
        group.append(np.full(free.sum(), number))
    return np.concatenate(off), np.concatenate(sigma), np.concatenate(group)


@dataclass(frozen=True)
class Study:
    """A recording with its estimate; maps (n, 3) over the volume, in mm.

    truth_mm, found_mm : without the rigid motion of the whole volume
    sigma_mm : stated standard uncertainty of the map
    """

    recording: Recording
    seen: Observations
    found: Estimate
    within: Volume
    truth_mm: np.ndarray
    found_mm: np.ndarray
    sigma_mm: np.ndarray

    @property
    def left_mm(self) -> np.ndarray:
        """What compensation by the estimate would leave, (n, 3)."""
        return self.truth_mm - self.found_mm

    @property
    def share_left(self) -> float:
        """Mean length of the error left over that before."""
        return self.within.mean_length(self.left_mm) / self.within.mean_length(
            self.truth_mm
        )

    @property
    def covered(self) -> float:
        """Share of the volume's components inside their 95 % intervals."""
        return self.within.share(np.abs(self.left_mm) < 1.96 * self.sigma_mm)


def study(
    recording: Recording,
    *,
    perpendicular_only: bool = False,
    seen: Observations | None = None,
) -> Study:
    """Align and estimate as the product does; judge by the exact truth."""
    run = run_of(recording)
    seen = seen or align_all([run], [run.name])[0]
    models = build_run_models(seen.at.machine, [seen.at])
    found = estimate(models, [seen], perpendicular_only=perpendicular_only)
    within = volume(run.machine)
    error, sigma = map_mm(within, found.model, found.theta, found.covariance)
    truth = true_map_mm(within, recording.truth)
    return Study(recording, seen, found, within, truth, error, sigma)
