"""Machines of a service in a few numbers, for scripts and for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from truepath.app.cli.terminal import print_table

K = 2.0
_UNITS = {"um": "µm", "urad": "µrad"}
_LABELS = {"p95": "95 % of the places"}
_TEXTS = ("maker", "model", "serial_number", "control", "customer", "place")
_NOT_USABLE = "not-usable"
_NONE = "–"


def summarise_machine(
    record: Mapping[str, Any], history: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a machine with its newest usable calibration, None where there is none.

    history : its volumetric error over all calibrations
    """
    usable = [c for c in history["calibrations"] if c["verdict"] != _NOT_USABLE]
    newest = _summarise_calibration(usable[-1], history) if usable else None
    return {**record, "calibration": newest, "standing": None}


def print_machines(every: Sequence[Mapping[str, Any]]) -> None:
    """Print a line a machine."""
    rows = [
        [
            one["id"],
            one["name"],
            _describe_state(one),
            *_describe_calibration(one["calibration"]),
            _describe_standing(one["standing"]),
        ]
        for one in every
    ]
    error = "volumetric error, µm"
    columns = ["machine", "name", "state", "calibrated", "age", error, "standing"]
    print_table("machines", columns, rows)


def print_machine(one: Mapping[str, Any]) -> None:
    """Print who a machine is, its axes and devices, and how it stands."""
    measured, age, error = _describe_calibration(one["calibration"])
    devices = one["devices"]
    rows = [
        ("name", one["name"]),
        *((name.replace("_", " "), one[name]) for name in _TEXTS if one[name]),
        ("configured in", one["origin"]),
        ("state", _describe_state(one)),
        ("chain", str(one["machine_file"]["kinematic_chain"])),
        *_describe_axes(one["machine_file"]["axes"]),
        *((key, str(devices[key])) for key in sorted(devices) if devices[key]),
        (
            "version",
            f"{one['version']}, since {_show_time(one['versions'][0]['since'])}",
        ),
        ("calibrated", f"{measured} {age and f'({age} ago)'}".strip()),
        ("volumetric error, µm", error),
        ("tolerance, µm", _show_number(one["tolerance_um"])),
        *_describe_judgement(one["standing"]),
    ]
    width = max(len(name) for name, _ in rows)
    print(one["id"])
    for name, text in rows:
        print(f"  {name:{width}s}  {text}")


def print_history(found: Mapping[str, Any]) -> None:
    """Print a quantity over the calibrations, an entry a column."""
    columns = [
        "measured",
        *(_name_entry(e) for e in found["entries"]),
        "verdict",
        "job",
    ]
    rows = [
        [
            _show_time(one["measured"]),
            *(
                _show_estimate(value, u)
                for value, u in zip(one["value"], one["uncertainty"], strict=True)
            ),
            one["verdict"] or _NONE,
            one["job_id"],
        ]
        for one in found["calibrations"]
    ]
    title = (
        f"{found['quantity']} of {found['machine']}, {_UNITS[found['unit']]} (k = 2)"
    )
    print_table(title, columns, rows)


def print_comparison(found: Mapping[str, Any]) -> None:
    """Print one quantity of several machines, the smallest first."""
    rows = [
        [
            one["machine"],
            _show_estimate(one["value"], one["uncertainty"]),
            _show_number(one["tolerance_um"]),
            ", ".join(one["is_more_than"]) or _NONE,
            _show_time(one["measured"]),
        ]
        for one in found["machines"]
    ]
    entry = {"label": found["label"], "position": found["position"]}
    unit = _UNITS[found["unit"]]
    columns = ["machine", f"{unit} (k = 2)", "tolerance, µm", "more than", "measured"]
    print_table(f"{found['quantity']}, {_name_entry(entry)}", columns, rows)


def _summarise_calibration(
    newest: Mapping[str, Any], history: Mapping[str, Any]
) -> dict[str, Any]:
    at = next(i for i, e in enumerate(history["entries"]) if e["label"] == "p95")
    value, uncertainty = newest["value"][at], newest["uncertainty"][at]
    age = datetime.now(UTC) - datetime.fromisoformat(newest["measured"])
    return {
        "job_id": newest["job_id"],
        "measured": newest["measured"],
        "age_hours": max(0.0, age.total_seconds() / 3600.0),
        "verdict": newest["verdict"],
        "volumetric_error_p95_um": value,
        "expanded_uncertainty_um": None if uncertainty is None else K * uncertainty,
        "coverage_factor": K,
    }


def _describe_state(one: Mapping[str, Any]) -> str:
    if one["current_job"] is not None:
        return "measuring"
    return "not driven" if one["cell"] == "none" else str(one["cell"])


def _describe_calibration(one: Mapping[str, Any] | None) -> tuple[str, str, str]:
    """Return when it was, how long ago, and the error with its uncertainty (k = 2)."""
    if one is None:
        return "never", "", _NONE
    hours = one["age_hours"]
    age = f"{hours:.0f} h" if hours < 48.0 else f"{hours / 24.0:.0f} d"
    value, expanded = one["volumetric_error_p95_um"], one["expanded_uncertainty_um"]
    half = None if expanded is None else expanded / K
    return _show_time(one["measured"]), age, _show_estimate(value, half)


def _describe_standing(standing: Mapping[str, Any] | None) -> str:
    if standing is None:
        return _NONE
    said = [f"tolerance: {standing['tolerance']}"] if standing["tolerance"] else []
    changed = standing["has_changed"]
    if changed is not None:
        said.append("changed" if changed else "unchanged")
    return ("ALARM: " if standing["is_alarm"] else "") + (", ".join(said) or _NONE)


def _describe_judgement(standing: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    if standing is None:
        return [("standing", _NONE)]
    texts = (standing["tolerance_text"], standing["change_text"])
    said = " ".join(text for text in texts if text)
    return [("standing", ("ALARM: " if standing["is_alarm"] else "") + said)]


def _describe_axes(axes: Mapping[str, Any]) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for name, axis in axes.items():
        unit = "deg" if axis["type"] == "rotary" else "mm"
        low, high = axis[f"min_{unit}"], axis[f"max_{unit}"]
        found.append((f"axis {name}", f"{low:g} to {high:g} {unit}"))
    return found


def _show_time(stamp: str) -> str:
    return f"{datetime.fromisoformat(stamp).astimezone():%Y-%m-%d %H:%M}"


def _name_entry(entry: Mapping[str, Any]) -> str:
    label, position = str(entry["label"]), entry["position"]
    if position is not None:
        return f"at {position:g} {entry.get('position_unit', '')}".strip()
    return _LABELS.get(label, label)


def _show_estimate(value: float | None, uncertainty: float | None) -> str:
    if value is None:
        return _NONE
    return f"{value:.1f} ± " + (
        _NONE if uncertainty is None else f"{K * uncertainty:.1f}"
    )


def _show_number(value: float | None) -> str:
    return _NONE if value is None else f"{value:g}"
