"""Figures of `docs/validation.md`: one look, the same bytes from the same numbers."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "figures" / "validation"
LARGEST = 200_000  # bytes

TRUTH, OURS, PAPER, DATA = "#1f4e79", "#c0392b", "#7f8c8d", "#2c7a4b"

mpl.rcParams.update(
    {
        "svg.hashsalt": "validation",
        "svg.fonttype": "none",
        "font.family": "sans-serif",
        "font.size": 9.0,
        "axes.grid": True,
        "grid.color": "#dddddd",
        "grid.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "figure.facecolor": "white",
        "legend.frameon": False,
    }
)


def save(figure: Figure, name: str) -> None:
    """Write a figure, `.svg` or `.png` by its name; none too large for a page."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / name
    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=metadata, dpi=90, bbox_inches="tight")
    plt.close(figure)
    if path.suffix == ".svg":
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join(line.rstrip() for line in lines) + "\n", "utf-8")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"{name} has {path.stat().st_size} bytes")
    print(f"figure {name}: {path.stat().st_size // 1024} KiB", flush=True)
