"""Machines whose axes grow, and what a slow tracker records of them."""

from dataclasses import replace
from functools import partial

from recorded import load_small, record_path
from truepath_simulators.worlds.synthetic import Setting

load_slow_tracker = partial(load_small, share=1.0)


def stretch(truth, name, strain):
    """Return the machine with a linear axis longer by a strain, from its zero on."""
    axes = truth.machine.linear_axes
    column, axis = next((k, a) for k, a in enumerate(axes) if a.name == name)
    joint = truth.joints[name]
    motions = list(joint.translation)
    motions[column] = motions[column].shift(strain * (axis.low - axis.zero_mm), strain)
    grown = replace(joint, translation=tuple(motions))
    return replace(truth, joints={**truth.joints, name: grown})


def record_warm(content, path, truth, seed):
    return record_path(content, path, seed, setting=Setting(truth=truth))[1]
