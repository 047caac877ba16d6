"""A result in a few numbers, and an effect in a line: as JSON and as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from truepath.cli.terminal import list_files, print_files, print_table, say
from truepath.files.earlier.verdict import verdict_from_json

Result = Mapping[str, Any]
UNITS = {"um": "µm", "urad": "µrad"}
_EFFECT_KEYS = (
    "name",
    "axis",
    "motion",
    "by",
    "plane",
    "symbol",
    "direction",
    "circle",
)
_MOST_REASONS = 12
_COVERAGE = 2.0  # k of uncertainties that are shown
_KINDS = ("lowest", "highest", "uncertainty")


def summarise_result(result: Result, folder: Path) -> dict[str, Any]:
    """Main figures for scripts; the rest is in `result.json`."""
    trials = result["monte_carlo"]
    return {
        "schema": "summary/1",
        "machine": result["machine"]["name"],
        "mode": result["mode"],
        "verdict": result["verdict"],
        "runs": [{"name": r["name"], "mode": r["mode"]} for r in result["runs"]],
        "error_tables": {
            symbol: {
                f"{kind}_{unit}": value
                for kind, value in zip(_KINDS, span, strict=True)
            }
            for symbol, unit, *span in _yield_spans(result)
        },
        "squareness_urad": result["squareness_urad"],
        "axis_location": result.get("axis_location", {}),
        "effects": result["effects"],
        "residual_rms_um": result["residuals"]["rms_um"],
        "observability": result["observability"],
        "grade": result["grade"],
        "monte_carlo": trials
        and {k: v for k, v in trials.items() if not isinstance(v, Mapping | list)},
        "files": list_files(folder),
    }


def print_result(result: Result, folder: Path) -> None:
    """Print the verdict, a summary of the error tables, and unobserved parameters."""
    print_verdict(result["verdict"])
    rows = [
        (symbol, f"{low:.1f}", f"{high:.1f}", _expanded(uncertainty), UNITS[unit])
        for symbol, unit, low, high, uncertainty in _yield_spans(result)
    ]
    rows += [
        (name, f"{at['value']:.1f}", "", _expanded(at["uncertainty"]), "µrad")
        for name, at in result["squareness_urad"].items()
    ]
    rows += [
        (name, f"{at[f'value_{unit}']:.1f}", "", _expanded(u), UNITS[unit])
        for name, at in result.get("axis_location", {}).items()
        for unit in (find_unit(at, "value"),)
        for u in (at[f"uncertainty_{unit}"],)
    ]
    columns = ("error", "lowest", "highest", "largest U (k = 2)", "")
    print_table(f"Errors of {result['machine']['name']}", columns, rows)
    for effect in result["effects"]:
        print(describe_effect(effect))
        if effect["agrees"] is False:
            print("this measurement contradicts its value in the model: discover again")
    for statement in result["observability"]["unobservable"]:
        print(f"not determined: {statement}")
    for statement in result["observability"]["weak"]:
        print(f"poorly observable: {statement}")
    if result["grade"] is not None:
        print(f"grade of the set-up: {result['grade']['text']}")
    print(f"residuals {result['residuals']['rms_um']:.2f} µm rms")
    if (trials := result["monte_carlo"]) is not None:
        print(_describe_trials(trials))
    print_files(list_files(folder))
    _print_outcome(result, folder)


def _expanded(uncertainty: float) -> str:
    return f"{_COVERAGE * uncertainty:.2f}"


def _print_outcome(result: Result, folder: Path) -> None:
    verdict = verdict_from_json(result["verdict"])
    print(f"verdict: {verdict.title.lower()}")
    error = result["volumetric_error"]
    before, after = (
        _describe_error(error[key]) for key in ("before", "after_expected")
    )
    print(f"volumetric error: {before} (k = 2; grid, mean of both directions)")
    print(f"after compensation: {after} (k = 2; the same, all corrected)")
    if (left := error.get("left_in_both_directions")) is not None:
        print(
            f"with lost motion that stays: {_describe_error(left)} (k = 2; each "
            "direction, mean over places that fill the travel evenly)"
        )
    if verdict.state != "not-usable":
        print(f"next: truepath export {folder / 'result.json'} --format F -o FILE")


def _describe_error(statistics: Mapping[str, Mapping[str, float]]) -> str:
    return ", ".join(
        f"{name} {of['value_um']:.1f} ± {_COVERAGE * of['uncertainty_um']:.1f} µm"
        for name in ("mean", "largest")
        for of in (statistics[name],)
    )


def warn_of_verdict(stated: Result, what: str = "the result") -> None:
    """Warn on standard error if a result is not usable without reservation."""
    objection = verdict_from_json(stated).objection
    if objection:
        say(f"warning: {what} is {objection}")


def print_verdict(stated: Result) -> None:
    """Print verdict and reasons, the worst first; nothing for an unreserved one."""
    verdict = verdict_from_json(stated)
    if verdict.objection:
        print(f"*** {verdict.title.upper()} ***")
    ranked = list(verdict.rank())
    for reason, remedy in ranked[:_MOST_REASONS]:
        print(f"- {reason} {remedy}".rstrip())
    if len(ranked) > _MOST_REASONS:
        print(f"- and {len(ranked) - _MOST_REASONS} more")


def _describe_trials(trials: Result) -> str:
    count = f"{trials['trials']:,} trials"
    if not trials["settled"]:
        return f"{count} did not settle: the linear uncertainty is not validated"
    return (
        f"{count} (JCGM 101) validate the linear uncertainty of {trials['agreeing']} "
        f"of {trials['numbers']} numbers; U differs by "
        f"{100.0 * trials['largest_disagreement']:.1f} % at most"
    )


def _yield_spans(result: Result) -> Iterator[tuple[str, str, float, float, float]]:
    for symbol, table in result["error_tables"].items():
        unit = find_unit(table, "value")
        value, uncertainty = table[f"value_{unit}"], table[f"uncertainty_{unit}"]
        yield symbol, unit, min(value), max(value), max(uncertainty)


def find_unit(content: Mapping[str, Any], quantity: str) -> str:
    """Unit in the key of a quantity: um, else urad."""
    return "um" if f"{quantity}_um" in content else "urad"


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Name, keys and numbers of an effect of `discovery.json`, as text."""
    keys = [effect[key] for key in _EFFECT_KEYS if key in effect]
    numbers = [_describe_number(name, m) for name, m in effect["parameters"].items()]
    return f"{' '.join(keys)}: {', '.join(numbers)} (k = 2)"


def _describe_number(name: str, measured: Mapping[str, Any]) -> str:
    values, sigmas = measured["value"], measured["uncertainty"]
    if not isinstance(values, list):
        values, sigmas = [values], [sigmas]
    texts = [f"{v:.3g} ± {2.0 * s:.2g}" for v, s in zip(values, sigmas, strict=True)]
    return f"{name} {', '.join(texts)}"
