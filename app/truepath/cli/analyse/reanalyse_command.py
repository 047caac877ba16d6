"""`truepath reanalyse`: many Runs of a running service, by the present code."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

import typer

from truepath.cli.service_client import HERE, Address, CaFile, KeyFile, open_client
from truepath.cli.terminal import (
    Json,
    NotedProgress,
    print_json,
    print_table,
    say,
    show_progress,
)


def reanalyse(
    run_ids: Annotated[
        list[str] | None, typer.Argument(metavar="RUN...", help="Runs of the service.")
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(help="In their place: all Runs of this machine of the service."),
    ] = None,
    since: Annotated[
        datetime | None, typer.Option(help="Only Runs since then, by local time.")
    ] = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Analyse Runs again and say what has changed; Ctrl-C leaves the job running."""
    from truepath.cli.calibration import follow_to_the_end

    order: dict[str, Any] = {"kind": "reanalyse"}
    if run_ids:
        order["run_ids"] = run_ids
    if machine is not None:
        order["machine"] = machine
    if since is not None:
        order["since"] = since.astimezone().isoformat()
    with open_client(address, key_file, ca_file) as client:
        job_id = client.create_job(**order)["id"]
        with show_progress("reanalyse") as on_progress:
            follow_to_the_end(client, job_id, _show_share(on_progress))
        summary = client.get_reanalysis(job_id)
    if json:
        print_json(summary)
    else:
        _print_summary(job_id, summary)


def _show_share(on_progress: NotedProgress) -> NotedProgress:
    def show(share: float, stage: str, _note: str = "") -> None:
        on_progress(share, stage, f"{100 * share:.0f} % of the Runs")

    return show


def _print_summary(job_id: str, summary: dict[str, Any]) -> None:
    rows = [
        [
            one["name"] or one["run_id"],
            _show(one["before"], "volumetric_error_um"),
            _show(one["after"], "volumetric_error_um"),
            _show(one["before"], "verdict"),
            _show(one["after"], "verdict"),
        ]
        for one in summary["analyses"]
    ]
    columns = ["Run", "before, µm", "after, µm", "verdict before", "after"]
    print_table("mean volumetric error", columns, rows)
    print(
        f"job {job_id}: {summary['analysed']} of {summary['total']} Runs analysed, "
        f"{summary['failed']} failed, {summary['unchanged']} of {summary['compared']} "
        "unchanged"
    )
    for one in summary["analyses"]:
        if one["failure"]:
            say(f"failed: {one['name'] or one['run_id']}: {one['failure']['detail']}")


def _show(figures: dict[str, Any] | None, name: str) -> str:
    if figures is None or figures[name] is None:
        return ""
    value = figures[name]
    return f"{value:.2f}" if isinstance(value, float) else str(value)
