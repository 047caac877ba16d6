"""The figures of the report."""

# Matplotlib leaves its keyword arguments untyped.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize

from app.estimation.volumetric_map import volumetric_map
from app.kinematics.effects.base import standstill
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.machine import Axis, LinearAxis, position_unit
from app.kinematics.symbols import error_motions, meaning
from app.reporting.error_tables import MILLI, ErrorTable, error_table
from app.reporting.findings import Findings
from app.reporting.svg import Colour, axes_of, figure, inline_svg
from app.reporting.volumetric_error import with_rotary_axes

SIGN = {"um": "µm", "urad": "µrad"}
_COVERAGE = 2.0  # k of expanded uncertainties
_BAND = 0.22
_DRAWN = 121  # positions of a curve
# Readable on light and on dark paper.
_SIZES = LinearSegmentedColormap.from_list("sizes", ["#3d6fd6", "#b04fae", "#f0803c"])


def axis_figure(found: Findings, axis: Axis) -> str:
    """Draw the six error motions of an axis, each with its band of ±2u."""
    with figure(4.3) as drawn:
        panels = axes_of(drawn, 2, 3)
        for panel, symbol in zip(panels, error_motions(axis.name), strict=True):
            panel.set_title(f"{symbol}  {meaning(symbol)}")
            table = _fine_table(found, symbol)
            if table is None:
                _blank(panel, "not observable\nwith the measured target")
            else:
                _motion(panel, table)
        for panel in panels[3:]:
            panel.set_xlabel(f"{axis.name}, {position_unit(axis)}")
        return inline_svg(drawn, f"Error motions of axis {axis.name} over its travel")


def _fine_table(found: Findings, symbol: str) -> ErrorTable | None:
    """Return an error motion as densely as it is drawn."""
    estimate = found.estimate
    part = estimate.model.slices.get(symbol)
    motion = next((e for e in estimate.model.effects if e.name == symbol), None)
    if part is None or not isinstance(motion, ErrorMotion):
        return None
    at_mm = np.linspace(motion.axis.low, motion.axis.high, _DRAWN)
    theta, covariance = estimate.theta[part], estimate.covariance[part, part]
    return error_table(motion, theta, covariance, at_mm)


def _motion(panel: Axes, table: ErrorTable) -> None:
    half = _COVERAGE * table.uncertainty
    panel.axhline(0.0, color=Colour.MUTED, linewidth=0.6)
    panel.fill_between(
        table.position_mm,
        table.value - half,
        table.value + half,
        color=Colour.ACCENT,
        alpha=_BAND,
        linewidth=0,
    )
    panel.plot(table.position_mm, table.value, color=Colour.ACCENT)
    panel.set_ylabel(SIGN[table.unit])
    panel.margins(x=0.01)


def _blank(panel: Axes, text: str) -> None:
    panel.set_axis_on()
    panel.grid(visible=False)
    panel.set_xticks([])
    panel.set_yticks([])
    panel.spines[:].set_linestyle((0, (3, 3)))
    panel.spines[:].set_visible(True)
    panel.text(
        0.5,
        0.5,
        text,
        transform=panel.transAxes,
        ha="center",
        va="center",
        color=Colour.MUTED,
    )


def volume_figure(found: Findings) -> str:
    """Draw the deformed volume, and how the error is spread before and after."""
    with figure(3.7) as drawn:
        left, right = axes_of(drawn, 1, 2, width_ratios=[1.15, 1.0])
        _volume(left, found)
        _distribution(right, found)
        return inline_svg(
            drawn,
            "Left: the working volume with its errors exaggerated. Right: share of the "
            "volume within a given error, before and after compensation",
        )


def _volume(panel: Axes, found: Findings) -> None:
    model = found.estimate.model
    nominal = np.array(list(_lattice(model.machine.linear_axes)))
    flat = nominal.reshape(-1, 3)
    error = MILLI * volumetric_map(model).error_mm(
        standstill(model.machine, with_rotary_axes(model.machine, flat)),
        found.estimate.theta,
    )
    size = np.linalg.norm(error, axis=1)
    reach = float(np.ptp(flat, axis=0).max())
    factor = _round_down(0.09 * reach / max(float(size.max()) / MILLI, 1e-9))
    moved = (flat + factor / MILLI * error).reshape(nominal.shape)
    panel.add_collection(
        LineCollection(
            list(_projected(nominal)), colors=Colour.MUTED, linewidths=0.4, alpha=0.5
        )
    )
    lines = _projected(moved)
    pieces = np.stack([lines[:, :-1], lines[:, 1:]], axis=2).reshape(-1, 2, 2)
    sizes = size.reshape(nominal.shape[:2])
    shade = 0.5 * (sizes[:, :-1] + sizes[:, 1:])
    coloured = LineCollection(
        list(pieces), cmap=_SIZES, norm=Normalize(0.0, size.max()), linewidths=1.3
    )
    coloured.set_array(shade.ravel())
    panel.add_collection(coloured)
    _name_axes(panel, model.machine.linear_axes, reach)
    panel.set_title(f"Volume with its errors, exaggerated {factor:,.0f} times")
    panel.set_aspect("equal")
    panel.autoscale_view()
    panel.set_axis_off()
    bar = panel.figure.colorbar(
        coloured, ax=panel, shrink=0.6, aspect=26, location="bottom", pad=0.02
    )
    bar.set_label("length of the volumetric error, µm")
    bar.outline.set_visible(False)


def _lattice(axes: tuple[LinearAxis, ...]) -> Iterator[Float64[np.ndarray, "m 3"]]:
    """Yield straight lines on the faces of the volume, parallel to its edges."""
    low = np.array([axis.min_mm for axis in axes])
    high = np.array([axis.max_mm for axis in axes])
    run, stations = np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 4)
    for along in range(3):
        u, v = (i for i in range(3) if i != along)
        for a in stations:
            for b in stations:
                if {a, b} & {0.0, 1.0}:
                    line = np.empty((len(run), 3))
                    line[:, along], line[:, u], line[:, v] = run, a, b
                    yield low + line * (high - low)


def _projected(points_mm: Float64[np.ndarray, "... 3"]) -> Float64[np.ndarray, "... 2"]:
    """Look at the volume from front, right and above."""
    x, y, z = np.moveaxis(points_mm, -1, 0)
    across = np.array([0.88, 0.47])
    up = np.array([-0.22, 0.34])
    return np.stack(
        [across[0] * x + across[1] * y, up[0] * x + up[1] * y + 0.93 * z], axis=-1
    )


def _name_axes(panel: Axes, axes: tuple[LinearAxis, ...], reach: float) -> None:
    low = np.array([axis.min_mm for axis in axes])
    high = np.array([axis.max_mm for axis in axes])
    for i, axis in enumerate(axes):
        # Beside the middle of an edge in front of the volume.
        place = np.array([low[0], low[1], low[2]], float)
        place[i] = 0.5 * (low[i] + high[i])
        if i == 1:
            place[0] = high[0]
        outward = np.array([[-0.03, -0.07], [0.05, -0.05], [-0.06, 0.0]])[i]
        x, y = _projected(place) + outward * reach
        panel.text(x, y, axis.name, ha="center", va="center", color=Colour.MUTED)


def _round_down(number: float) -> float:
    """Return the number with one leading digit of 1, 2 or 5."""
    power = 10.0 ** np.floor(np.log10(number))
    return float(power * max(d for d in (1.0, 2.0, 5.0) if d * power <= number * 1.001))


def _distribution(panel: Axes, found: Findings) -> None:
    before = np.sort(np.linalg.norm(found.volumetric.error_um, axis=1))
    after = found.volumetric.after_lengths_um
    for lengths, colour, label in (
        (before, Colour.ACCENT, "before"),
        (after, Colour.SECOND, "after, expected"),
    ):
        share = np.linspace(0.0, 100.0, len(lengths))
        panel.plot(np.maximum(lengths, 1e-3), share, color=colour, label=label)
    lowest = max(float(np.quantile(after, 0.02)), 1e-3)
    panel.set_xscale("log")
    panel.set_xlim(_round_down(lowest), None)
    panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panel.set_xlabel("length of the volumetric error, µm")
    panel.set_ylabel("share of the volume, %")
    panel.set_title("Volumetric error before and after compensation")
    panel.legend(loc="upper left")


def residual_figure(found: Findings) -> str:
    """Draw what is left on each line against the noise, and its distribution."""
    with figure(2.5) as drawn:
        left, right = axes_of(drawn, 1, 2, width_ratios=[2.2, 1.0])
        _by_line(left, found)
        _histogram(right, found)
        return inline_svg(
            drawn, "Residuals by line, and the distribution of their components"
        )


def _by_line(panel: Axes, found: Findings) -> None:
    lines, floor = found.by_line, MILLI * found.estimate.residuals.floor_mm
    panel.vlines(lines.row, 0.0, lines.rms_um, color=Colour.ACCENT, linewidth=2.0)
    panel.axhline(floor, color=Colour.SECOND, linewidth=1.0, linestyle=(0, (4, 2)))
    otf = found.provenance.run.mode == "otf"
    name = "line" if otf else "point"
    panel.set_title(f"Residual by {name} (dashed: what noise alone leaves)")
    panel.set_xlabel("row of the path" if otf else "row of the points")
    panel.set_ylabel("rms, µm")
    panel.set_ylim(0.0, None)
    panel.grid(visible=False, axis="x")


def _histogram(panel: Axes, found: Findings) -> None:
    residual = MILLI * found.estimate.residuals.residual_mm
    reach = max(3.0 * float(np.std(residual)), 1e-3)
    colours = (Colour.ACCENT, Colour.SECOND, Colour.THIRD)
    labels = ("beam", "azimuth", "elevation")
    for component, colour, label in zip(residual.T, colours, labels, strict=True):
        share, edge = np.histogram(component, 41, (-reach, reach))
        panel.stairs(
            100.0 * share / len(component), edge, color=colour, label=label, linewidth=1
        )
    panel.set_title("Distribution of cells")
    panel.set_xlabel("residual, µm")
    panel.set_ylabel("share, %")
    panel.legend(loc="upper right", handlelength=1.0, borderaxespad=0.0)
