"""What a service tells of one machine: its file, a path, estimates, a result."""

import copy
import math

import numpy as np

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
TRACKER_NOISE = {"range_sigma_um": 1.0, "angle_sigma_urad": 3.0, "rate_hz": 500}
TRACKER_STANDS_MM = np.array([1200.0, 300.0, -80.0])


def device(model, number):
    names = {"maker": "Truepath", "model": model, "serial_number": number}
    return {**names, "firmware": "1.0"}


TRACKER = device("Simulated tracker", "T-0001")
MOTION = device("Simulated CNC", "C-0001") | {"has_watchdog": True}
GRADE = {
    "number": 0.86,
    "verdict": "usable",
    "thresholds": {"good": 0.25, "usable": 1.0},
    "text": "0.86, usable: …",
    "expected_uncertainty_um": 6.5,
    "sample_sigma_um": 7.6,
    "tracker": {"position_mm": [270, 1430, 0], "assumed": True, "best_number": 0.69},
    "improved_number": 0.34,
    "weakest": [
        {
            "error": "ECX",
            "meaning": "turn of X about Z",
            "at_tool_um": 6.3,
            "remedy": "add a line along Y at the low end of X and the middle of Z",
        }
    ],
    "weak_shapes": [],
    "unobservable": [],
}


ARMING = {
    "machine_name": "VMC 500",
    "targets": [{"name": "", "on": "tool", "offset_mm": [20.0, 30.0, -150.0]}],
    "envelope": [
        {"axis": "X", "unit": "mm", "low": 12.5, "high": 487.5},
        {"axis": "Y", "unit": "mm", "low": 10.0, "high": 390.0},
        {"axis": "Z", "unit": "mm", "low": -290.0, "high": -10.0},
    ],
    "max_feed_mm_min": 6000.0,
    "duration_s": 125.0,
    "rows": 23,
    "grows": False,
    "plan_sha256": "a1",
}


def version(number, *difference):
    names = ("kind", "what", "text")
    return {
        "id": f"job-{number - 1}",
        "version": number,
        "created": f"2026-03-{12 + number}T08:30:00.000Z",
        "difference": [dict(zip(names, one, strict=True)) for one in difference],
    }


VERSIONS = [
    version(
        2,
        ("added", "backlash Y", "backlash Y: width 6.39 ± 0.15 µm"),
        ("changed", "EXX", "EXX at X 250 mm: from −1.2 to 3.4 ± 0.5 µm"),
        ("changed", "C0Y", "C0Y: from 12.0 to 18.5 ± 1.1 µrad"),
    ),
    version(1),
]


def lines_off(lines=22):
    """Return how far each line is off: Y− most, the later ones more."""
    return [
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
        for row in range(1, lines + 1)
    ]


DISCOVERY = {
    "schema": "discovery/1",
    "lines": lines_off(),
    "effects": [
        {
            "name": "backlash",
            "axis": "Y",
            "grade": "certain",
            "parameters": {"width_um": {"value": 6.385, "uncertainty": 0.076}},
            "evidence": {"log_bayes_factor": 512.0, "share_of_gap": 0.934},
            "indistinguishable_from": [{"name": "servo-mismatch", "axis": "Y"}],
            "cause": "Play or wind-up in screw, nut, thrust bearing or rack.",
            "looks_like": "An axis stops short by the same width.",
            "remedy": "Enter the width as backlash compensation.",
        },
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
    "gap": {
        **{"unit": "um", "noise_floor": 1.17, "expected": 1.19},
        **{"before": 2.41, "after": 1.21},
    },
    "explained_by": {
        "before": {
            "line": 0.45,
            "direction of Y": 0.36,
            "region of X and Y": 0.12,
            "temperature of X": 0.05,
            "moving axis": 0.04,
            "time": 0.03,
            "beam": 0.001,
        },
        "after": {"line": 0.14, "direction of Y": 0.01, "time": 0.02},
    },
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
    """A plan as the service has made it."""
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
        "tracker_is_assumed": True,
        "unobservable": [
            "ECZ (roll of Z) cannot be told; a second target separates it"
        ],
    }


def result():
    rng = np.random.default_rng(11)
    tables = {}
    for axis in "XYZ":
        travel = MACHINE["axes"][axis]
        position = np.linspace(travel["min_mm"], travel["max_mm"], 21)
        s = np.linspace(0.0, 1.0, len(position))
        for motion in "XYZABC":
            unit = "um" if motion in "XYZ" else "urad"
            size = 6.0 if unit == "um" else 14.0
            waves = sum(
                rng.normal(scale=1.0 / k) * np.sin(k * math.pi * s + rng.uniform(0, 6))
                for k in (1, 2, 3)
            )
            waves = size * (waves - waves[0])
            if unit == "um" and motion != axis:
                waves = waves - s * waves[-1]
            u = (0.25 if unit == "um" else 0.8) * (1 + 1.6 * (2 * s - 1) ** 2)
            tables[f"E{motion}{axis}"] = {
                "position_mm": position.round(3).tolist(),
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
        "alignment": {},
        "residuals": {"rms_um": 4.3},
        "observability": {
            "rank": 161,
            "parameters": 165,
            "unobservable": [
                "ECZ (roll of Z) is not distinguishable from EXZ, EYZ with this offset"
            ],
        },
        "provenance": {},
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


ROTARY = {"type": "rotary", "min_deg": 0.0, "max_deg": 360.0, "origin_mm": [0, 0, 0]}
TURNTABLE = {
    **MACHINE,
    "name": "Turntable",
    "kinematic_chain": "w-C-X-b-Y-Z-t",
    "axes": {**MACHINE["axes"], "C": ROTARY},
}


def turntable_estimate(done):
    """Return an estimate that also has the error motions of a rotary axis."""
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
        sizes = {"mean": 1.0, "p95": 1.7, "largest": 2.1}
        return {
            name: {"value_um": factor * mean, "uncertainty_um": factor * u}
            for name, factor in sizes.items()
        }

    return {"before": spread(15.3, 0.1), "after_expected": spread(0.7, 0.05)}


def volumetric_map(state, compensation):
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


FORMATS = [
    {
        "name": "heidenhain",
        "control": "Heidenhain TNC",
        "carries": "positioning with backlash, straightness and squareness",
        "choices": {"backlash_reading": ["negative-value", "difference"]},
    },
    {
        "name": "linuxcnc",
        "control": "LinuxCNC",
        "carries": "positioning of each axis, forward and reverse",
        "choices": {},
    },
]


def compensation(job_id, name, unmeasured):
    settled = name == "linuxcnc"
    address = f"/api/v1/jobs/{job_id}/compensations/{name}-10-{unmeasured}"
    after = {"mean": 3.21, "largest": 8.0, "mean_uncertainty": 0.045}
    return {
        "id": f"{name}-10-{unmeasured}",
        "format": name,
        "control": {f["name"]: f["control"] for f in FORMATS}[name],
        "not_carried": "straightness, angular errors, squareness",
        "sign": {"rule": "the value is the error", "verified": settled},
        "unmeasured": [] if settled else ["X not measured from 450 to 500 mm: holds"],
        "volumetric_error_um": {
            "before": {"mean": 15.32, "largest": 30.0},
            "after": after,
            "after_where_measured": {**after, "mean": 2.9},
        },
        "note": "name each file as COMP_FILE of its [JOINT_n]",
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
    names = ("maker", "model", "serial_number", "control", "customer", "place")
    entry = {"id": machine_id, "name": MACHINE["name"], **dict.fromkeys(names, "")}
    entry |= {"origin": "settings", "devices": {"tracker_driver": "streaming"}}
    entry |= {"tolerance_um": None, "connected": True, "cell": "ready", "version": 3}
    return {**entry, **more}


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
                "expected_after_uncertainty": [0.05, 0.1, 0.1],
            }
            for number, when in enumerate(measured, 1)
        ],
    }


def verification(result_id, conformity="within"):
    """A result held against points that it was not made from, the last on a line."""
    sizes = {"mean": 1.0, "p95": 1.6, "largest": 2.1}

    def spread(mean):
        values = {name: factor * mean for name, factor in sizes.items()}
        return values | {f"{name}_uncertainty": 0.1 for name in sizes}

    decision = {"conformity": conformity, "tolerance_um": 5.0, "coverage_factor": 3.5}
    decision |= {"length_um": 2.1, "expanded_uncertainty_um": 0.4}
    return {
        "asked": {"result_id": result_id},
        "statements": ["Measurement and result agree."],
        "agreement": {
            "consistent": True,
            "chance": 0.42,
            "share_within_expanded": 0.96,
            "chance_of_any_machine": 0.5,
        },
        "conformity": {} if conformity is None else {"measured": decision},
        "volumetric_error_um": {
            "measured": spread(1.1),
            "predicted": spread(1.0),
            "deviation": spread(0.4),
        },
        "compensated": True,
        "map_scale": {"value": 0.01, "uncertainty": 0.02, "cause": None},
        "places": {
            "row": list(range(30)),
            "position": [[16.0 * i, 13.0 * i, -10.0 * i] for i in range(30)],
            "standstill": [i < 29 for i in range(30)],
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
        "standard": "iso-230-4",
        "diameter_mm": 307.2,
        "feed_mm_min": 3000.0,
        "driven_feed_mm_min": {"counterclockwise": 2999.2, "clockwise": 3000.6},
        "row": {"counterclockwise": 2, "clockwise": 3},
        "samples": {"counterclockwise": 9600, "clockwise": 9600},
        "sector_deg": 3.0,
        "angle_deg": angle_deg.tolist(),
        "radial_um": both(shift_um + oval_um + half_um, shift_um + oval_um - half_um),
        "predicted_radial_um": both(oval_um, oval_um),
        "centre_um": {"measured": [20.0, -5.0], "predicted": [0.0, 0.0]},
        "figures_um": figures,
        "uncertainty_um": dict.fromkeys(figures, 0.9),
        "by_the_noise_alone_um": dict.fromkeys(figures, 1.2),
        "predicted_um": figures | {"H": 0.0},
        "predicted_uncertainty_um": dict.fromkeys(figures, 0.1),
        "difference_um": {
            name: {"value": 0.0, "expanded_uncertainty": 1.8, "within": name != "H"}
            for name in figures
        },
    }
    return {"circles_in_motion": [circle], "circles_missing": [9]}


def comparison():
    compared = {"largest_en": 0.4, "share_within": 1.0, "largest_difference_um": 0.62}
    square = {"difference_urad": -4.5, "en": -1.8}
    means = {"result_mean_um": 5.2, "reference_mean_um": 5.9, "difference_mean_um": 1.1}
    return {
        "errors": {"EXX": compared},
        "numbers": {"C0Y": square},
        "volumetric": means,
        "not_compared": {"EYX": "the result does not hold it"},
        "links": {"report_html": "/api/v1/jobs/job-1/comparisons/a1/report.html"},
    }


def temperature_dependence():
    """How a machine depends on temperature: X grows, its tilt is not seen to."""
    growth = {"value_um_per_m_K": 11.4, "uncertainty_um_per_m_K": 0.3}
    return {
        "verdict": "usable",
        "reference_degC": 20.0,
        "measured_degC": [18.1, 24.9],
        "calibrations": [{}] * 4,
        "dependences": [
            {"symbol": "C0Y", "is_significant": False, "chance": 0.6},
            {"symbol": "EXX", "is_significant": True, "chance": 0.0001},
        ],
        "expansion": {"X": {**growth, "is_significant": True}},
        "volumetric_um_per_K": {"value": 3.2, "uncertainty": 0.1},
        "coefficients": {
            "EXX": {
                "position_mm": [0.0, 500.0],
                "value_um_per_K": [0.0, 5.7],
                "uncertainty_um_per_K": [0.0, 0.2],
            },
            "C0Y": {"value_urad_per_K": 0.4, "uncertainty_urad_per_K": 0.5},
        },
    }


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
