"""Temperature of the machine when a result was measured, from its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truepath.answers.temperature.temperature_model import ResultAtTemperature
from truepath.documents.file_model import parse_json
from truepath.documents.whole_files import read_whole
from truepath.errors import BadInput
from truepath.files.bundle.run import number_names
from truepath.files.earlier.result_file import LARGEST_BYTES, result_from_json

SCALES = ("X", "Y", "Z")
THERMOMETER_K = 0.1  # of a typical thermometer, without what all results share
_EVEN = 12.0**0.5  # range of an even spread by its standard deviation


def read_machine_temperature(
    content: Mapping[str, Any],
    name: str,
    sensors: Sequence[str] = (),
    thermometer_k: float = THERMOMETER_K,
) -> tuple[float, float]:
    """Temperature of a result and its standard uncertainty, °C and K.

    content : of a `result.json`; name : of the result, for errors
    sensors : whose mean is taken; those of the scales of its axes if none are given

    Runs are weighted by duration. The uncertainty combines that of the thermometers and
    the change of temperature during the measurement.

    Raises BadInput where a sensor is missing.
    """
    wanted = sensors or [s for s in content["machine"]["axes"] if s in SCALES]
    runs = content.get("runs") or ()
    if not runs:
        raise BadInput(f"{name} states no temperature; state it by --degc")
    shown = [_read_run(run, name, wanted) for run in runs]
    mean, low, high = np.array(shown).T
    weight = np.array([float(run["measured_s"]) for run in runs])
    weight /= weight.sum()
    changed_k = float(high.max() - low.min())
    return float(weight @ mean), float(np.hypot(thermometer_k, changed_k / _EVEN))


def _read_run(
    run: Mapping[str, Any], name: str, wanted: Sequence[str]
) -> tuple[float, float, float]:
    known = {
        str(one["name"]).removesuffix("_degC"): one
        for one in run.get("environment", {}).get("sensors") or ()
        if one["used"] and one["mean"] is not None
    }
    missing = [sensor for sensor in wanted if sensor not in known]
    if missing:
        others = ", ".join(known) or "none"
        raise BadInput(
            f"{name}: Run {run['name']} has no temperature of {missing[0]} (it has "
            f"{others}); choose others by --sensor, or state temperatures by --degc"
        )
    means = [known[sensor]["mean"] for sensor in wanted]
    ends = [[known[sensor][end] for sensor in wanted] for end in ("low", "high")]
    return float(np.mean(means)), float(np.mean(ends[0])), float(np.mean(ends[1]))


def read_results(
    files: Sequence[Path],
    names: Sequence[str] = (),
    *,
    times_h: Sequence[float] | None = None,
    degc: Sequence[float] | None = None,
    sensors: Sequence[str] = (),
    thermometer_k: float = THERMOMETER_K,
) -> list[ResultAtTemperature]:
    """Read results with their temperatures.

    names : of the results; their paths where none are given
    times_h : when each was measured, hours from any origin; None where unknown
    degc : temperature of each, in place of that in its file

    Raises BundleError with the place in a file, BadInput where a temperature is
    missing, NotUsable where a result is not to be used.
    """
    names = names or number_names([str(file) for file in files])
    found: list[ResultAtTemperature] = []
    for k, (file, name) in enumerate(zip(files, names, strict=True)):
        content = parse_json(read_whole(file, largest_bytes=LARGEST_BYTES), str(file))
        result = result_from_json(content, file=str(file))
        result.verdict.require_usable(f"{file}: the result")
        if degc is None:
            known: Any = content
            shown = read_machine_temperature(known, name, sensors, thermometer_k)
        else:
            shown = float(degc[k]), thermometer_k
        time_s = None if times_h is None else 3600.0 * times_h[k]
        found.append(ResultAtTemperature(name, result, *shown, time_s))
    return found
