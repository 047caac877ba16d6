"""Machines whose axes grow, and what a slow tracker records of them."""

from dataclasses import replace

from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic


def load_slow_tracker(name):
    content = load_machine(name)
    return {**content, "tracker": {**content["tracker"], "rate_hz": 100}}


def stretch(truth, name, strain):
    """Return the machine with a linear axis longer by a strain, from its zero on."""
    column, axis = next(
        (k, a) for k, a in enumerate(truth.machine.linear_axes) if a.name == name
    )
    joint = truth.joints[name]
    motions = list(joint.translation)
    motions[column] = motions[column].shift(strain * (axis.low - axis.zero_mm), strain)
    grown = replace(joint, translation=tuple(motions))
    return replace(truth, joints={**truth.joints, name: grown})


def record_warm(content, path, truth, seed):
    speed = path.feed_mm_min / 60.0
    program = Program(path.position, speed, path.dwell_s, target=path.target)
    setting = synthetic.Setting(truth=truth)
    return synthetic.record(content, program, seed, "otf", setting)
