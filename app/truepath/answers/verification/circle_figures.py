"""Circles of ISO 230-4 that were executed on the fly, as the tracker measured them.

No clock is shared: angle and radius of each sample are its own, about the commanded
centre; what lies beyond the middle 360° of an arc is run-in and run-out. The radius is
averaged over sectors of 3°, so that the noise of single samples makes no figure. About
the centre of the circle of least squares of both senses,

    H   largest difference of both senses at one angle           circular hysteresis
    G   range of the radius, in both senses and in each       circular deviation
    F   largest and smallest radius less the commanded one        radial deviation

Noise enlarges a range. By how much is estimated by adding noise to the significant part
of the shape, the harmonics above the universal threshold (Donoho and Johnstone 1994):
that is subtracted from the figures, and most of it is part of their uncertainty. The
scale of air and tracker affects F alone: it makes a circle larger, and leaves it one.
Other errors of the tracker bend both senses alike and count as noise that these share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import ArcDrive
from truepath.alignment.observations.reduction import beam_frame
from truepath.answers.verification.reduced_points import correlate_means
from truepath.estimation.problem.noise import NoiseModel
from truepath.files.units import UM_PER_MM
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.numerics.rigid import RigidTransform

SECTORS = 120
SECTOR_DEG = 360.0 / SECTORS
OTHER_FEED = 0.03  # of the commanded one; controls keep it far better
FIGURES = ("H", "G", "G_counterclockwise", "G_clockwise", "F_max", "F_min")
_FEWEST_SAMPLES = 5  # of a sector
_SENSES = ("counterclockwise", "clockwise")
_DRAWS = 400
_BIAS_SHARE = 0.7  # of what noise adds: that is not known better

Sectors = Float64[np.ndarray, " s"]


@dataclass(frozen=True, slots=True)
class CommandedCircle:
    """One commanded arc, in the frame that the tracker is mounted on.

    centre_mm : (3,); along : (2, 3) motion of the target per mm of both axes
    begin_deg, turn_deg : about the centre, from the first axis towards the second
    """

    plane: str
    centre_mm: Float64[np.ndarray, "3"]
    along: Float64[np.ndarray, "2 3"]
    radius_mm: float
    begin_deg: float
    turn_deg: float
    feed_mm_min: float

    @property
    def sense(self) -> str:
        """As seen with the first axis to the right and the second upwards."""
        return _SENSES[int(self.turn_deg < 0.0)]

    def place_mm(self, angle_deg: Sectors) -> Float64[np.ndarray, "s 3"]:
        """Nominal positions, mm."""
        return self.centre_mm + self.radius_mm * self.outwards(angle_deg)

    def outwards(self, angle_deg: Sectors) -> Float64[np.ndarray, "s 3"]:
        """Unit vectors from the centre."""
        angle = np.radians(angle_deg)
        return np.column_stack([np.cos(angle), np.sin(angle)]) @ self.along


@dataclass(frozen=True, slots=True)
class DrivenCircle:
    """One sense of a circle, averaged over sectors from 0° on.

    radial_mm : radius less the commanded one; time_s, span_s : of each sector
    covariance_mm2 : (s, s) of radial_mm; feed_mm_min : as measured
    """

    commanded: CommandedCircle
    drive: ArcDrive
    radial_mm: Sectors
    time_s: Sectors
    span_s: Sectors
    covariance_mm2: Float64[np.ndarray, "s s"]
    feed_mm_min: float
    samples: int


def list_sector_angles() -> Sectors:
    """Middles of the sectors, deg."""
    return SECTOR_DEG * (np.arange(SECTORS) + 0.5)


def average_over_sectors(
    commanded: CommandedCircle,
    drive: ArcDrive,
    time_s: Float64[np.ndarray, " n"],
    tracker_mm: Float64[np.ndarray, "n 3"],
    pose: RigidTransform,
    noise: NoiseModel,
    tracker: TrackerNoise,
) -> DrivenCircle | None:
    """The middle turn of an arc; None where a sector of it is missing.

    time_s, tracker_mm : valid samples from standstill to standstill
    pose : of the tracker, from the frame it is mounted on
    """
    off = (pose.invert().apply(tracker_mm) - commanded.centre_mm) @ commanded.along.T
    sign = np.sign(commanded.turn_deg)
    angle = np.degrees(np.unwrap(np.arctan2(off[:, 1], off[:, 0])))
    turned = sign * (angle - angle[0])
    turned += (sign * (angle[0] - commanded.begin_deg) + 180.0) % 360.0 - 180.0
    begin = 0.5 * (abs(commanded.turn_deg) - 360.0)
    inside = np.flatnonzero((turned >= begin) & (turned < begin + 360.0))
    if len(inside) < SECTORS * _FEWEST_SAMPLES:
        return None
    sector = (np.floor(angle[inside] / SECTOR_DEG).astype(np.int64)) % SECTORS
    count = np.bincount(sector, minlength=SECTORS)
    if count.min() < _FEWEST_SAMPLES:
        return None
    radial = np.linalg.norm(off[inside], axis=1) - commanded.radius_mm
    mean_s = np.bincount(sector, time_s[inside], SECTORS) / count
    span_s = count / tracker.rate_hz
    white_mm = float(np.std(np.diff(radial))) / np.sqrt(2.0)
    covariance = _build_noise(commanded, pose, noise, tracker, mean_s, span_s)
    # Samples in motion scatter more than at rest: vibration, rough guides.
    more = np.maximum(white_mm**2 / count - np.diag(covariance), 0.0)
    covariance += np.diag(more)
    took_s = float(time_s[inside[-1]] - time_s[inside[0]])
    turned_rad = np.radians(turned[inside[-1]] - turned[inside[0]])
    return DrivenCircle(
        commanded,
        drive,
        np.bincount(sector, radial, SECTORS) / count,
        mean_s,
        span_s,
        covariance,
        60.0 * commanded.radius_mm * float(turned_rad) / took_s,
        len(inside),
    )


def fit_centre(radial: Float64[np.ndarray, "s e"]) -> Float64[np.ndarray, "2 e"]:
    """Centres of the circles of least squares, from the commanded one.

    radial : radius less the commanded one, in one sense or the mean of both; the centre
        is in its unit
    """
    # Equal sectors all round: sine, cosine and the mean are orthogonal.
    return 2.0 / SECTORS * (_list_outwards().T @ radial)


def subtract_centre(
    radial: Float64[np.ndarray, "s e"], centre: Float64[np.ndarray, "2 e"]
) -> Float64[np.ndarray, "s e"]:
    """Radius less the commanded one about another centre, to first order."""
    return radial - _list_outwards() @ centre


def compute_figures(
    both: dict[str, Float64[np.ndarray, "s e"]],
) -> dict[str, Float64[np.ndarray, " e"]]:
    """Figures of e circles by name, of the senses that there are.

    both : radius less the commanded one by sense
    """
    centre = fit_centre(np.mean(list(both.values()), axis=0))
    centred = {sense: subtract_centre(one, centre) for sense, one in both.items()}
    every = np.concatenate(list(centred.values()))
    figures = {"G": np.ptp(every, axis=0)}
    figures |= {"F_max": every.max(axis=0), "F_min": every.min(axis=0)}
    for sense, one in both.items():
        figures[f"G_{sense}"] = np.ptp(subtract_centre(one, fit_centre(one)), axis=0)
    if len(both) == 2:
        there, back = both.values()
        figures["H"] = np.abs(there - back).max(axis=0)
    return {name: figures[name] for name in FIGURES if name in figures}


@dataclass(frozen=True, slots=True)
class StatedFigures:
    """Figures by name, µm, k = 1; own_um : what the noise alone would make of each."""

    value_um: dict[str, float]
    uncertainty_um: dict[str, float]
    own_um: dict[str, float]


def estimate_figures(
    radial_mm: dict[str, Sectors],
    covariance_mm2: dict[str, Float64[np.ndarray, "s s"]],
    common_mm: dict[str, Float64[np.ndarray, "s c"]] | None = None,
    scale_mm: float = 0.0,
) -> StatedFigures:
    """Figures of a measurement less the contribution of its errors.

    common_mm : radii by one standard uncertainty of each error of the tracker, the same
        in both senses
    scale_mm : standard uncertainty of the radius by the scale of all lengths
    """
    rng = np.random.default_rng(1)
    noise = {sense: sample_normal(rng, one) for sense, one in covariance_mm2.items()}
    error = noise
    if common_mm:
        count = next(iter(common_mm.values())).shape[1]
        shared = rng.standard_normal((count, _DRAWS))
        error = {s: one + common_mm[s] @ shared for s, one in noise.items()}
    shape = _extract_shape(radial_mm, error)
    raw = compute_figures({sense: one[:, None] for sense, one in radial_mm.items()})
    clear = compute_figures({sense: one[:, None] for sense, one in shape.items()})
    more = compute_figures(
        {sense: shape[sense][:, None] + error[sense] for sense in shape}
    )
    own = compute_figures(noise)
    value: dict[str, float] = {}
    uncertainty: dict[str, float] = {}
    for name, one in raw.items():
        added = float(more[name].mean() - clear[name][0])
        stated = float(one[0]) - added
        is_radius = name[0] == "F"
        value[name] = UM_PER_MM * (stated if is_radius else max(stated, 0.0))
        parts = more[name].std(), _BIAS_SHARE * added, is_radius * scale_mm
        uncertainty[name] = UM_PER_MM * float(np.linalg.norm(parts))
    by_noise = {name: UM_PER_MM * float(one.mean()) for name, one in own.items()}
    return StatedFigures(value, uncertainty, by_noise)


def _list_outwards() -> Float64[np.ndarray, "s 2"]:
    angle = np.radians(list_sector_angles())
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _extract_shape(
    radial_mm: dict[str, Sectors], noise: dict[str, Float64[np.ndarray, "s e"]]
) -> dict[str, Sectors]:
    there, *back = radial_mm
    if not back:
        return {there: _threshold_harmonics(radial_mm[there], noise[there])}
    a, b = radial_mm[there], radial_mm[back[0]]
    x, y = noise[there], noise[back[0]]
    mean = _threshold_harmonics(0.5 * (a + b), 0.5 * (x + y))
    half = _threshold_harmonics(0.5 * (a - b), 0.5 * (x - y))
    return {there: mean + half, back[0]: mean - half}


def _threshold_harmonics(values: Sectors, noise: Float64[np.ndarray, "s e"]) -> Sectors:
    """Only the harmonics whose power is above what noise may make of any of them."""
    wave = np.fft.rfft(values)
    power = np.mean(np.abs(np.fft.rfft(noise, axis=0)) ** 2, axis=1)
    clear = np.abs(wave) ** 2 > power * (np.log(len(wave)) + 1.0)
    return np.fft.irfft(np.where(clear, wave, 0.0), len(values))


def sample_normal(
    rng: np.random.Generator, covariance: Float64[np.ndarray, "s s"]
) -> Float64[np.ndarray, "s d"]:
    """Samples with a covariance, one per column."""
    value, vector = np.linalg.eigh(covariance)
    scale = np.sqrt(np.maximum(value, 0.0))
    return (vector * scale) @ rng.standard_normal((len(value), _DRAWS))


def _build_noise(
    commanded: CommandedCircle,
    pose: RigidTransform,
    noise: NoiseModel,
    tracker: TrackerNoise,
    time_s: Sectors,
    span_s: Sectors,
) -> Float64[np.ndarray, "s s"]:
    angle_deg = list_sector_angles()
    place_mm = pose.apply(commanded.place_mm(angle_deg))
    outwards = commanded.outwards(angle_deg) @ pose.rotation.T
    local = np.einsum("sij,sj->si", beam_frame(place_mm), outwards)
    stated = tracker.sigma_mm(np.linalg.norm(place_mm, axis=1))[:, [0, 1, 1]]
    scaled = local * stated
    white = np.array([noise.white[0], noise.white[1], noise.white[1]])
    ou = np.array(noise.ou)
    order = np.argsort(time_s)
    shared = np.empty((SECTORS, SECTORS))
    shared[np.ix_(order, order)] = correlate_means(
        time_s[order], span_s[order], noise.ou_time_s
    )
    count = span_s * tracker.rate_hz
    own = ((scaled * white) ** 2).sum(axis=1) / count
    return ((scaled * ou) @ (scaled * ou).T) * shared + np.diag(own)
