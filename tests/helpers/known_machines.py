"""Machines that err in a known way: as results state them, and exact ones."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from truepath.compensation import rotary_residual
from truepath.compensation.format_registry import load_format
from truepath.compensation.tables import error_map
from truepath.compensation.tables.tabulation import Tabulation
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.compensation.correction import measure_deviation_mm
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine


def build_model(content, **options):
    """Build the model of a machine, once for all tests."""
    return _build(json.dumps(content), **options)


@cache
def _build(text, **options):
    machine = machine_from_json(json.loads(text), file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    return build_identifiable_model(machine, offsets, **options)[0]


def map_known(model, values, variance=1e-16):
    theta = values
    if not isinstance(theta, np.ndarray):
        theta = np.zeros(model.size)
        for name, value in dict(values).items():
            theta[model.slices[name]] = value
    covariance = np.diag(np.broadcast_to(variance, model.size))
    return error_map.map_errors(CalibrationResult(model, theta, covariance))


def tabulate(errors, name, spacing_mm=50.0, **choices):
    """What makes files of errors, with tables over the whole travel."""
    ranges = error_map.compute_measured_ranges(errors.machine, {}, None)
    return Tabulation(load_format(name, choices), "c", ("by hand",), spacing_mm, ranges)


def along(errors, axis, at):
    place = np.tile(errors.middle_mm, (len(at), 1))
    place[:, errors.machine.axis_names.index(axis)] = at
    return place


@dataclass(frozen=True)
class Written:
    """Files of a machine with rotary axes, and what their account states of these."""

    files: Mapping[str, str]
    over: Mapping[str, Any]  # all axes
    rotary: Mapping[str, Any]


def write(errors, name, spacing_mm=50.0):
    """Return files of a format without the costly rest of their account."""
    made = tabulate(errors, name, spacing_mm)
    content = made.tabulate(errors)
    files = made.kind.write(content)
    rotary = rotary_residual.read_rotary_files(made.kind, content, files)
    correction = made.kind.read(files, errors.machine)
    over = rotary_residual.measure_over_axes(errors, correction, rotary)
    return Written(files, over or {}, rotary_residual.describe_rotary(errors, rotary))


def displace(content, places):
    truth = perfect(parse_machine(dict(content)))
    joints = dict(truth.joints)
    for place in places:
        own, at = place.axis.name, place.location
        off = [at.get(f"{letter}O{own}", 0.0) for letter in "XYZABC"]
        moved = {"shift_mm": tuple(off[:3]), "tilt_rad": tuple(off[3:])}
        joints[own] = replace(joints[own], **moved)
    return replace(truth, joints=joints)


def find_ends(errors):
    return np.array([(axis.low, axis.high) for axis in errors.axes]).T


def spread(machine, count):
    low, high = find_ends(machine)
    unit = np.random.default_rng(2).uniform(size=(count, len(low)))
    return low + unit * (high - low)


def measure_left(truth, files, position):
    """Return lengths of errors, mm, without files and once a control has them."""
    corrections = None, LoadedTables(files).correct(truth.machine)
    left = (measure_deviation_mm(truth, one, position) for one in corrections)
    return [np.linalg.norm(one, axis=1) for one in left]
