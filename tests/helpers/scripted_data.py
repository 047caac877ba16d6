"""What a service tells of one machine: its file, a path, estimates, a result."""

import copy
import json
import math
from importlib import resources

import numpy as np

from truepath.compensation.format_registry import describe_format, load_format
from truepath.kinematics.effects.family import describe_family, find_family

EXAMPLES = json.loads(
    resources.files("truepath.service.api").joinpath("examples.json").read_text("utf-8")
)
"""What the interface gives as an answer of each route; not to be changed."""

MACHINE = {
    "schema": "machine/1",
    "name": "VMC 500",
    "kinematic_chain": "w-X-b-Y-Z-t",
    "axes": {
        "X": {"type": "linear", "min_mm": 0.0, "max_mm": 500.0},
        "Y": {"type": "linear", "min_mm": 0.0, "max_mm": 400.0},
        "Z": {"type": "linear", "min_mm": -300.0, "max_mm": 0.0},
    },
    "tool_offset_mm": [20.0, 30.0, -150.0],
}
TRACKER_STANDS_MM = np.array([1200.0, 300.0, -80.0])
DEVICES = EXAMPLES["connect_machine"]
(_VERSION,) = EXAMPLES["list_model_versions"]
_SQUARER = {
    "kind": "changed",
    "what": "C0Y",
    "text": "C0Y: from 12.0 to 18.5 ± 1.1 µrad",
}
VERSIONS = [
    _VERSION | {"difference": [*_VERSION["difference"], _SQUARER]},
    _VERSION | {"version": 1, "difference": []},
]


LINES_OFF = [  # Y− most, the later ones more
    {
        "run": 0,
        "segment": row,
        "axis": "XYZ"[row % 3],
        "direction": "+-"[row % 2],
        "time_s": 3600.0 + 5.6 * row,
        "feed_mm_min": 6000.0,
        "before_um": 1.5 + 0.05 * row + 4.0 * (row % 6 == 1),
        "after_um": 1.2,
        "temperature_degC": {"X": 20.0 + 0.05 * row},
    }
    for row in range(1, 23)
]
(_BACKLASH,) = EXAMPLES["get_discovery"]["effects"]
DISCOVERY = EXAMPLES["get_discovery"] | {
    "lines": LINES_OFF,
    "effects": [
        _BACKLASH
        | {"indistinguishable_from": [{"name": "servo-mismatch", "axis": "Y"}]},
        {
            "name": "setup-step",
            "parameters": {
                "t_s": {"value": 40.02, "uncertainty": 0.03},
                "step_um": {"value": [4.0, -3.0, 0.1], "uncertainty": [0.1] * 3},
            },
            "evidence": {"log_bayes_factor": 80.0, "share_of_gap": 0.066},
            "indistinguishable_from": [],
            "cause": "The mount was knocked.",
            "looks_like": "All lines after one moment are shifted.",
            "remedy": "Clamp the mount.",
        },
    ],
    "unnamed": [
        {
            "structure": "time-wave",
            "depends_on": ["t"],
            "description": "a wave in time along Z with a period of 31 s",
            "rms_um": 0.8,
            "direction": "Z",
            "parameters": {
                "period_s": {"value": 31.04, "uncertainty": 0.06},
                "amplitude_um": {"value": 1.13, "uncertainty": 0.05},
            },
            "evidence": {"log_bayes_factor": 31.4, "share_of_gap": 0.02},
            "indistinguishable_from": [],
            "cause": "Something switches with a steady period.",
            "looks_like": "All points move to and fro.",
            "remedy": "Find what runs with this period.",
        }
    ],
}


ASK = {
    "reason": "backlash Y and servo-mismatch Y explain the measurement alike. …",
    "questions": [
        {"between": ["backlash Y", "servo-mismatch Y"], "expected_log_bayes": 23.4},
        {"between": ["setup-step", ""], "expected_log_bayes": 15.2},
    ],
    "decides": True,
    "path": "ask/path.csv",
    "rows": [
        {"x_mm": x, "y_mm": y, "z_mm": -290.0, "feed_mm_min": feed, "dwell_s": 0.35}
        for x, y, feed in [(10, 10, 6000), (94, 390, 6000), (10, 10, 2400)]
    ],
    "lines": 2,
    "duration_s": 16.4,
}


def planned_path(lines=22):
    """Return chords through the travel, ends on its faces."""
    rng = np.random.default_rng(5)
    low = np.array([10.0, 10.0, -290.0])
    high = np.array([490.0, 390.0, -10.0])
    share, number = rng.random((lines + 1, 3)), np.arange(lines + 1)
    share[number, rng.integers(0, 3, lines + 1)] = number % 2
    share[0] = 0.0
    position = low + share * (high - low)
    columns = {"feed_mm_min": [6000.0] * len(number), "dwell_s": [0.35] * len(number)}
    position = np.round(position, 3).tolist()
    return {"kind": "path", "axes": ["X", "Y", "Z"], "position": position, **columns}


def made_plan(predicted=None):
    return {
        "id": "plan-1",
        "state": "succeeded",
        "progress": 1.0,
        "commanded": planned_path(),
        "document": {"stations": None, "predicted": predicted},
    }


def plan_curve(rows=23):
    """Return uncertainty against time along `planned_path`, five seconds a row."""
    points = []
    for row in range(3, rows + 1, 4):
        sigma = 4.0 * (row / 3) ** -1.0
        point = {"row": row, "time_s": 5.0 * row, "volumetric_uncertainty_um": sigma}
        point["expanded_volumetric_uncertainty_um"] = 2 * sigma
        point["grade"] = {"number": sigma / 8.0, "verdict": "usable"}
        error = "ECX" if row < 15 else "EXX"
        points.append({**point, "weakest": [{"error": error, "at_tool_um": 0.5}]})
    points[-1]["grade"]["verdict"] = "good"
    return {
        "plan_id": "plan-1",
        "points": points,
        "tracker_mm": TRACKER_STANDS_MM.tolist(),
        "unobservable": [
            "ECZ (roll of Z) cannot be told; a second target separates it"
        ],
    }


def result():
    tables, s = {}, np.linspace(0.0, 1.0, 21)
    for axis, travel in MACHINE["axes"].items():
        low, high = travel["min_mm"], travel["max_mm"]
        for number, motion in enumerate("XYZABC", 1):
            unit, size = ("um", 0.25) if motion in "XYZ" else ("urad", 0.8)
            waves = 12.0 * size * np.sin(number * math.pi * s) * (1.0 + s)
            u = size * (1 + 1.6 * (2 * s - 1) ** 2)
            tables[f"E{motion}{axis}"] = {
                "position_mm": (low + (high - low) * s).round(3).tolist(),
                f"value_{unit}": waves.round(3).tolist(),
                f"uncertainty_{unit}": u.round(3).tolist(),
            }
    del tables["ECZ"]
    return {
        "schema": "result/1",
        "machine": MACHINE,
        "mode": "otf",
        "error_tables": tables,
        "squareness_urad": {
            "C0Y": {"value": 23.4, "uncertainty": 0.9},
            "B0Z": {"value": -11.8, "uncertainty": 1.1},
            "A0Z": {"value": 5.2, "uncertainty": 1.2},
        },
        "residuals": {"rms_um": 4.3},
        "observability": {
            "rank": 161,
            "parameters": 165,
            "unobservable": [
                "ECZ (roll of Z) is not distinguishable from EXZ, EYZ with this offset"
            ],
        },
    }


def residuals(lines=6, cells=20):
    """Return residuals along lines of a path; the fourth row stands out."""
    rng = np.random.default_rng(3)
    along = []
    for row in range(1, lines + 1):
        parts = (3.0 if row == 4 else 1.0) * rng.standard_normal((3, cells))
        names = ("beam_um", "azimuth_um", "elevation_um")
        line = dict(zip(names, parts.tolist(), strict=True))
        way = np.linspace(0.0, 400.0, cells).tolist()
        along.append({"row": row, "along_mm": way, **line})
    rows = [
        {"run": 0, "row": row, "cells": cells, "rms_um": 3.0 if row == 4 else 1.0}
        for row in range(1, lines + 1)
    ]
    return {"by_line": rows, "noise_floor_um": 1.1, "along_lines": along}


def half_differences():
    """Return what the direction of approach adds to two tables of `result`."""
    found = {}
    for symbol, size in (("EXX", 2.5), ("EBX", 6.0)):
        unit = "um" if symbol[1] in "XYZ" else "urad"
        position = result()["error_tables"][symbol]["position_mm"]
        sizes = {f"value_{unit}": size, f"uncertainty_{unit}": 0.2}
        columns = {name: [value] * len(position) for name, value in sizes.items()}
        found[symbol] = {"position_mm": position, **columns}
    return found


def estimate(done, total=22):
    """Return the live estimate after so many lines: it tightens with each."""
    final = result()
    wider = 40.0 / max(done, 1) ** 1.5
    tables = copy.deepcopy(final["error_tables"])
    for table in tables.values():
        for name in [name for name in table if name.startswith("uncertainty")]:
            table[name] = [round(wider * u, 3) for u in table[name]]
    return {
        "verdict": {"state": "usable", "reasons": [], "details": []},
        "error_tables": tables,
        "squareness_urad": {
            symbol: {"value": s["value"], "uncertainty": wider * s["uncertainty"]}
            for symbol, s in final["squareness_urad"].items()
        },
        "volumetric_uncertainty_um": round(0.5 * wider, 4),
        "done": done,
        "total": total,
        "elapsed_s": 5.6 * done,
        "age_s": 0.0,
        "is_last": False,
    }


TURNTABLE = {
    **MACHINE,
    "name": "Turntable",
    "kinematic_chain": "w-C-X-b-Y-Z-t",
    "axes": {
        **MACHINE["axes"],
        "C": {"type": "rotary", "min_deg": 0.0, "max_deg": 360.0},
    },
}


def turntable_estimate(done):
    found = estimate(done)
    degrees = np.linspace(0.0, 360.0, 37)
    for motion in "XYZABC":
        unit = "um" if motion in "XYZ" else "urad"
        found["error_tables"][f"E{motion}C"] = {
            "position_deg": degrees.tolist(),
            f"value_{unit}": (5 * np.sin(np.radians(degrees))).tolist(),
            f"uncertainty_{unit}": [1.5] * len(degrees),
        }
    found["axis_location"] = {
        "XOC": {"value_um": 12.5, "uncertainty_um": 0.4},
        "AOC": {"value_urad": -8.0, "uncertainty_urad": 1.0},
    }
    return found


def volumetric_error():
    def spread(mean, u):
        return {
            name: {"value_um": factor * mean, "uncertainty_um": factor * u}
            for name, factor in {"mean": 1.0, "p95": 1.7, "largest": 2.1}.items()
        }

    return {
        "before": spread(15.3, 0.1),
        "after_expected": spread(0.7, 0.05),
        "both_directions": spread(15.6, 0.1),
        "left_in_both_directions": spread(3.1, 0.2),
    }


def volumetric_map(state, compensation=None):
    """Return a map of five points an axis, its ends of X beyond what was measured."""
    travel = [(axis["min_mm"], axis["max_mm"]) for axis in MACHINE["axes"].values()]
    levels = [np.linspace(low, high, 5) for low, high in travel]
    position = np.stack([g.ravel() for g in np.meshgrid(*levels, indexing="ij")], 1)
    size = {"before": 1.0, "after": 0.0}[state] if compensation is None else 0.4
    share = (position - [0.0, 0.0, -300.0]) / [500.0, 400.0, 300.0]
    error = size * np.array([20.0, -10.0, 15.0]) * (share - 0.5)
    length = np.linalg.norm(error, axis=1) if size else np.full(len(error), 0.6)
    return {
        "state": state,
        "compensation": compensation,
        "points": 5,
        "axes": ["X", "Y", "Z"],
        "position": position.tolist(),
        "error_um": error.tolist(),
        "uncertainty_um": np.full(error.shape, 0.1).tolist(),
        "length_um": length.tolist(),
        "is_measured": (position[:, 0] > 0.0).tolist(),
    }


EFFECTS = [describe_family(find_family(n)) for n in ("backlash", "setup-step")]
FORMATS = {
    name: describe_format(name, load_format(name))
    for name in ("heidenhain", "linuxcnc")
}


def compensation(job_id, name, unmeasured):
    made, number = EXAMPLES["create_compensation"], f"{name}-10-{unmeasured}"
    settled = name == "linuxcnc"
    address = f"/api/v1/jobs/{job_id}/compensations/{number}"
    return made | {
        "id": number,
        "format": name,
        "control": FORMATS[name]["control"],
        "sign": made["sign"] | {"verified": settled},
        "unmeasured": [] if settled else made["unmeasured"],
        "links": {"archive": f"{address}/archive"},
    }


def rotary_account():
    """What files leave of two rotary axes: C has a table, of A little is known."""

    def change(before, after, u):
        sizes = {"before": before, "after": 0.5 * after, "after_expected": after}
        return {**sizes, "after_expanded_uncertainty": u}

    return {
        "over_all_axes_um": {
            **change(21.4, 6.32, 0.41),
            "before_expanded_uncertainty": 0.52,
            "coverage_factor": 2.0,
        },
        "rotary": {
            "C": {
                "positioning_urad": change(48.3, 1.6, 0.7),
                "at_tool_um": change(11.27, 0.38, 0.16),
                "location_at_tool_um": change(14.1, 14.12, 0.6),
                "lost_motion": "in the files: both directions of the table",
                "lost_motion_urad": change(24.0, 0.9, 0.3),
                "not_in_files": ["EXC", "EYC", "EZC", "EAC", "EBC", "AOC", "BOC"],
            },
            "A": {
                "lost_motion": "not in the result",
                "lost_motion_urad": None,
                "not_in_files": [],
            },
        },
    }


def driver_option(name, kind, *, usual=None):
    """An option of a driver; without a usual value it has to be given."""
    return {"name": name, "type": kind, "default": usual, "is_required": usual is None}


_LINK = [driver_option("host", "str | None", usual=""), driver_option("port", "int")]
_MORE = [
    driver_option("compact", "bool", usual=False),
    driver_option("turn_s", "float", usual=20.0),
]
DRIVERS = [
    {"device": "tracker", "name": "geocom", "options": _LINK},
    {"device": "tracker", "name": "streaming", "options": [*_LINK, *_MORE]},
    {"device": "motion", "name": "modbus", "options": _LINK},
    {"device": "thermometer", "name": "registers", "options": _LINK},
]


def machine_entry(machine_id="default", **more):
    own = {"id": machine_id, "name": MACHINE["name"], "version": 3}
    own["devices"] = {"tracker_driver": "streaming"}
    return EXAMPLES["list_machines"]["items"][0] | own | more


def machine_history(machine_id, *measured):
    labels = ("mean", "p95", "largest")
    return {
        "machine": machine_id,
        "entries": [{"label": one, "position": None} for one in labels],
        "calibrations": [
            {
                "job_id": f"job-{number}",
                "measured": when,
                "verdict": "usable",
                "value": [15.3, 26.0, 32.1],
                "uncertainty": [0.1, 0.2, 0.4],
                "expected_after": [0.7, 1.2, 1.5],
            }
            for number, when in enumerate(measured, 1)
        ],
    }


def verification(result_id, conformity="within"):
    """A result held against points that it was not made from, the last on a line."""
    found = copy.deepcopy(EXAMPLES["get_verification"])
    decision = {"length_um": 2.1, "expanded_uncertainty_um": 0.4}
    found["conformity"]["measured"] |= decision | {"conformity": conformity}
    return found | {
        "asked": {"result_id": result_id},
        "compensated": True,
        "places": {
            "row": list(range(30)),
            "position": [[16.0 * i, 13.0 * i, -10.0 * i] for i in range(30)],
            "standstill": [i < 29 for i in range(30)],
            "conformity": [conformity] * 2 + ["within"] * 28,
            "measured_um": [[1.5, -2.0, 0.0]] * 30,
            "measured_uncertainty_um": [[0.2, 0.2, 0.2]] * 30,
        },
    }


def circles_in_motion():
    """A circle off its centre with play where X turns back, and one that is missing."""
    angle_deg = np.arange(1.5, 360.0, 3.0)
    angle = np.radians(angle_deg)
    half_um = 3.0 * np.sign(np.sin(angle))  # of the play: by the sense of X
    shift_um = 20.0 * np.cos(angle) - 5.0 * np.sin(angle)
    oval_um = 4.0 * np.cos(2.0 * angle)
    names = ("H", "G", "G_counterclockwise", "G_clockwise", "F_max", "F_min")
    figures = dict(zip(names, (6.1, 13.6, 12.2, 12.4, 7.0, -7.0), strict=True))

    def both(there, back):
        return {"counterclockwise": there.tolist(), "clockwise": back.tolist()}

    circle = {
        "plane": "XY",
        "diameter_mm": 307.2,
        "feed_mm_min": 3000.0,
        "driven_feed_mm_min": {"counterclockwise": 2999.2, "clockwise": 3000.6},
        "angle_deg": angle_deg.tolist(),
        "radial_um": both(shift_um + oval_um + half_um, shift_um + oval_um - half_um),
        "predicted_radial_um": both(oval_um, oval_um),
        "centre_um": {"measured": [20.0, -5.0], "predicted": [0.0, 0.0]},
        "figures_um": figures,
        "uncertainty_um": dict.fromkeys(figures, 0.9),
        "by_the_noise_alone_um": dict.fromkeys(figures, 1.2),
        "predicted_um": figures | {"H": 0.0},
        "predicted_uncertainty_um": dict.fromkeys(figures, 0.1),
        "difference_um": {name: {"within": name != "H"} for name in figures},
    }
    return {"circles_in_motion": [circle], "circles_missing": [9]}


def comparison():
    square = {"C0Y": {"difference_urad": -4.5, "en": -1.8}}
    return EXAMPLES["get_comparison"] | {"numbers": square}


def temperature_dependence():
    """How a machine depends on temperature: X grows, its squareness is not seen to."""
    found = copy.deepcopy(EXAMPLES["get_machine_temperature"])
    growth = {"value_um_per_m_K": 11.4, "uncertainty_um_per_m_K": 0.3}
    found["expansion"]["X"] |= growth | {"is_significant": True}
    found["dependences"][0] |= {"is_significant": True, "chance": 0.0001}
    found["dependences"].reverse()
    return found


def certificate(job_id, number, language):
    name = f"TP-20260314-{job_id.upper()}-{number}"
    address = f"/api/v1/jobs/{job_id}/certificates/{name}"
    return {
        "number": name,
        "issued_at": "2026-03-14T09:00:00Z",
        "issued_by": "anna",
        "language": language,
        "files": {"certificate.html": "0", "certificate.pdf": "0"},
        "links": {"html": f"{address}.html", "pdf": f"{address}.pdf"},
    }
