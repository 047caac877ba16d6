"""The comments of compensation files, lines of plain ASCII."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from truepath.app.compensation.error_map import ErrorMap
from truepath.app.compensation.format import CompensationFormat
from truepath.app.compensation.length_reference import describe_lengths
from truepath.app.compensation.tabulation import StatedTemperature
from truepath.app.compensation.unmeasured import MeasuredRange


def write_stamp(
    errors: ErrorMap,
    kind: CompensationFormat,
    name: str,
    measured: Mapping[str, MeasuredRange],
    temperature: StatedTemperature | None,
    lengths_degc: tuple[float, float] | None,
) -> tuple[str, ...]:
    """Return where the files come from and what they have, in plain ASCII.

    lengths_degc : temperatures of the machine that lengths hold at, where known
    """
    machine, provenance = errors.machine, errors.result.provenance
    verdict = errors.result.verdict
    celsius = f"measured at {_describe_temperature(provenance)}"
    if temperature:
        celsius = _describe_stated(temperature)
    offset = ", ".join(f"{v:g}" for v in machine.target().offset_mm)
    lines = (
        f"truepath compensation, format {name}",
        f"machine {machine.name}, chain {machine.chain}",
        f"for the tool at target offset {offset} mm",
        f"run {provenance.get('run', '')}, analysed {provenance.get('created', '')}",
        f"input {str(provenance.get('input_sha256', ''))[:16]}",
        celsius,
        describe_lengths(lengths_degc),
        f"valid over {', '.join(_list_ranges(errors, measured))}",
        f"units {kind.units}; directions of travel: {kind.directions}",
        f"carries {kind.carries}",
        f"sign ({'verified' if kind.sign_is_verified else 'to be tried'}): {kind.sign}",
        *(one.describe() for one in measured.values() if not one.is_known_whole),
        *(["THE RESULT IS " + verdict.title.upper()] if verdict.objection else []),
    )
    kept = (line.encode("ascii", "replace").decode() for line in lines)
    return tuple(" ".join(line.replace("#", " ").split()) for line in kept)


def describe_over_axes(over: Mapping[str, Any]) -> str:
    """Return what the files leave over the travel of all axes, in plain ASCII."""
    before, after = (
        f"{over[key]:.2f} +- {over[f'{word}_expanded_uncertainty']:.2f} um"
        for word, key in (("before", "before"), ("after", "after_expected"))
    )
    return (
        f"mean error over the travel of all axes {before}, with these files {after} "
        f"(k = {over['coverage_factor']:g})"
    )


def _list_ranges(
    errors: ErrorMap, measured: Mapping[str, MeasuredRange]
) -> Iterator[str]:
    for one in measured.values():
        if not one.is_stated:
            yield f"{one.axis.name} what the result does not state"
            continue
        yield f"{one.axis.name} {one.low:g} to {one.high:g} mm"
    for axis in errors.machine.rotary_axes:
        low, high = errors.result.measured.get(axis.name, (axis.low, axis.high))
        yield f"{axis.name} {low:g} to {high:g} deg"


def _describe_stated(stated: StatedTemperature) -> str:
    low, high = stated.model.measured_degc
    return (
        f"for a machine at {stated.at_degc:.1f} degC, from results at {low:.1f} to "
        f"{high:.1f} degC"
    )


def _describe_temperature(provenance: Mapping[str, Any]) -> str:
    stated: Mapping[str, Sequence[float]] = provenance.get("temperature_degC") or {}
    shown = [f"{name} {low:.1f} to {high:.1f}" for name, (low, high) in stated.items()]
    return f"{', '.join(shown)} degC" if shown else "a temperature that nothing states"
