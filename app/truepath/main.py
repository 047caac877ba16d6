"""Constructs the service and runs it; nothing else constructs anything.

Processes: this one (HTTP, jobs, catalogue), the cell process (devices, recording),
worker processes (science), one that estimates during a measurement; with `simulated`,
the bench's devices.
"""

from __future__ import annotations

import faulthandler
import json
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Connection

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.database import Database
from truepath.catalogue.locks import hold_catalogue, hold_folder
from truepath.catalogue.machine_registry import MachineRegistry, take_over_identities
from truepath.catalogue.run_reader import ReadingLimits, RunReader
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import (
    machine_from_json,
    machine_to_json,
    read_machine,
)
from truepath.jobs.dispatch.deletion import Deleted, Deletion, Retention, RetentionRules
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.dispatch.reconciliation import Reconciliation
from truepath.jobs.running.active_job import EventBus
from truepath.jobs.running.arming import ArmTokens
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.live_estimation import LiveEstimation
from truepath.jobs.workers.analysis_tasks import analyse_recorded, prepare
from truepath.jobs.workers.executor import ProcessExecutor
from truepath.jobs.workers.workers import choose_workers
from truepath.machine_settings import ONLY_MACHINE
from truepath.machines.machine_cells import (
    CellSetup,
    configure_cell,
    reject_same_names,
    reject_shared_links,
)
from truepath.machines.machine_setup import ConfiguredMachine, MachineSetup
from truepath.measurement.messages import CellConfig
from truepath.plugins import load
from truepath.service.api.application import create_application
from truepath.service.api.models.base import PREFIX
from truepath.service.api.server import (
    Server,
    bind_socket,
    end_by_signals,
    format_address,
)
from truepath.service.api.service import LEAST_FREE_BYTES, Service
from truepath.service.page import pages
from truepath.service_log import configure_log
from truepath.settings import Settings
from truepath.users.access import Access, AccessRules
from truepath.users.audit import AuditLog, Entry
from truepath.users.tls import TlsFiles, check_tls_files

_END_S = 60.0

log = structlog.get_logger(__name__)


def serve(
    settings: Settings, *, listening: Callable[[str], None] | None = None
) -> None:
    """Run the service until SIGTERM or Ctrl+C; both hold the feed before all else.

    A shutdown of more than a minute is ended by force, and the stacks are logged:
    children end with the process, and the watchdog of the machine holds what still
    moves.

    listening : receives the service's address once it answers, in a separate thread

    Raises BadInput, InUse.
    """
    configure_log(settings.log_level, settings.log_format, settings.log)
    tls = _check_tls(settings)
    with (
        _bound_end() as ending,
        open_service(settings) as service,
        bind_socket(settings.host, settings.port) as listener,
    ):
        _require_users(settings, service)
        address = format_address(listener, is_encrypted=tls is not None)
        _print_addresses(settings, address)
        app = create_application(
            service,
            trusted_hosts=settings.trusted_hosts,
            trusted_proxies=settings.trusted_proxies,
            root_path=settings.root_path,
            pages=pages.router,
        )
        app.mount(pages.STATIC_PATH, pages.static_files(), name="static")
        server = Server(
            app,
            service,
            address,
            listening,
            tls=tls,
            trusted_proxies=settings.trusted_proxies,
            ending=ending,
        )
        with end_by_signals(server):
            server.run(sockets=[listener])
    log.info("service ended")


@contextmanager
def _bound_end() -> Iterator[Callable[[], None]]:
    """Yields a function that starts the time limit for leaving."""
    try:
        yield partial(faulthandler.dump_traceback_later, _END_S, exit=True)
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def open_service(settings: Settings) -> Iterator[Service]:
    """Construct everything behind the routes; undone in reverse at the end."""
    with ExitStack() as stack:
        folder = settings.data_dir
        stack.enter_context(hold_folder(folder))
        stack.enter_context(_redirect_temporary_files(folder / "tmp"))
        database = Database(settings.database)
        stack.callback(database.close)
        database.migrate()
        stack.enter_context(hold_catalogue(database))
        event_bus = EventBus()
        context, setup = _make_context(settings, database, event_bus, stack)
        dispatcher = Dispatcher(context, event_bus, ArmTokens(settings.arm_token_s))
        stack.callback(dispatcher.close)
        dispatcher.interrupt_unfinished_jobs()
        _begin_to_reconcile(context, dispatcher, stack)
        for one in context.machines.list_all():
            one.start()
        _start_assessment(setup.calibrations, stack)
        access = Access(database, _make_rules(settings))
        stack.callback(access.close)
        deletion = Deletion(database, context.runs, context.results)
        rules = RetentionRules(settings.keep_runs_days, settings.keep_results_days)
        retention = Retention(
            context,
            setup.calibrations,
            deletion,
            rules,
            partial(_audit_retention, access.audit_log),
            lambda: dispatcher.is_measuring,
        )
        stack.callback(retention.close)
        retention.start()
        service = Service(
            version=version("truepath"),
            simulated=settings.simulated,
            database=database,
            store=context.store,
            runs=context.runs,
            results=context.results,
            dispatcher=dispatcher,
            event_bus=event_bus,
            machines=context.machines,
            setup=setup,
            calibrations=setup.calibrations,
            deletion=deletion,
            max_upload_bytes=settings.max_upload_mb << 20,
            max_streams=settings.max_streams,
            access=access,
        )
        stack.callback(service.end_streams)
        yield service


def _begin_to_reconcile(
    context: JobContext, dispatcher: Dispatcher, stack: ExitStack
) -> None:
    reconciliation = Reconciliation(context, lambda: dispatcher.is_measuring)
    stack.callback(reconciliation.close)
    reconciliation.start()


def _start_assessment(calibrations: Calibrations, stack: ExitStack) -> None:
    """In a thread, so that the service answers meanwhile."""
    look = threading.Thread(target=calibrations.assess_all, name="standing")
    look.start()
    stack.callback(look.join)


def _audit_retention(
    audit_log: AuditLog, connection: Connection, deleted: Deleted
) -> None:
    what = f"DELETE {PREFIX}/{deleted.kind}s/{deleted.id}"
    entry = Entry("", "", "retention", "", what, "204", old=deleted.files)
    audit_log.append_within(connection, entry)


def _make_context(
    settings: Settings, database: Database, event_bus: EventBus, stack: ExitStack
) -> tuple[JobContext, MachineSetup]:
    reader = RunReader(ReadingLimits(settings.upload_memory_mb))
    stack.callback(reader.close)
    results = settings.data_dir / "results"
    results.mkdir(exist_ok=True)
    store = Store(database, event_bus.publish)
    runs = RunCatalogue(database, settings.data_dir / "runs", reader)
    registry = MachineRegistry(database)
    calibrations = Calibrations(registry, store, runs, results, event_bus.publish)
    cells = CellSetup(
        settings.data_dir,
        LEAST_FREE_BYTES,
        calibrations,
        event_bus.publish,
        settings.temperature_drift_limit_degC,
    )
    setup = MachineSetup(registry, store, cells, calibrations)
    setup.load(_load_machines(settings, stack))
    take_over_identities(settings.data_dir, registry)
    machines = setup.machines
    stack.callback(machines.close)
    workers = choose_workers(settings)
    workers.check()
    executor = ProcessExecutor(settings.analysis_workers, prepare)
    stack.callback(executor.close)
    executor.warm()
    context = JobContext(
        store=store,
        runs=runs,
        results=results,
        executor=executor,
        science=analyse_recorded,
        workers=workers,
        machines=machines,
        calibrations=calibrations,
        registry=registry,
        read_loaded_files=setup.read_loaded_files,
        live=LiveEstimation,
    )
    return context, setup


def _check_tls(settings: Settings) -> TlsFiles | None:
    if settings.tls_cert is None or settings.tls_key is None:
        return None
    files = TlsFiles(settings.tls_cert, settings.tls_key)
    until = check_tls_files(files)
    log.info("certificate", file=str(files.cert), holds_until=f"{until:%Y-%m-%d}")
    return files


def _require_users(settings: Settings, service: Service) -> None:
    access = service.access
    if not settings.log_in_required or access.accounts.list_all():
        return
    raise BadInput(
        "nobody could log in: there is no user yet; on this computer, run "
        "`truepath users add NAME --role administrator` with the same settings"
    )


def _make_rules(settings: Settings) -> AccessRules:
    return AccessRules(
        log_in_required=settings.log_in_required,
        arming_by_key=settings.allow_arming_by_key,
        session_s=settings.session_hours * 3600.0,
        # A browser keeps no such cookie of a plain address beyond its own computer.
        secure_cookie=settings.tls_cert is not None or not settings.allow_plain_http,
    )


def _load_machines(settings: Settings, stack: ExitStack) -> list[ConfiguredMachine]:
    if settings.simulated:
        return _start_simulators(settings, stack)
    found = [
        ConfiguredMachine(
            machine_id, read_machine(one.machine_file), configure_cell(one)
        )
        for machine_id, one in settings.list_machines().items()
    ]
    if not found:
        log.warning("no machine_file: analyses only")
    reject_same_names((one.id, one.machine.name) for one in found)
    reject_shared_links((one.id, one.config) for one in found)
    return found


def _start_simulators(settings: Settings, stack: ExitStack) -> list[ConfiguredMachine]:
    contents: dict[str, Mapping[str, Any] | None] = {
        machine_id: _read_content(one.machine_file)
        for machine_id, one in settings.list_machines().items()
    }
    contents = contents or {ONLY_MACHINE: None}
    started = [
        _start_bench(settings, stack, machine_id, content, seed=seed)
        for seed, (machine_id, content) in enumerate(
            contents.items(), start=settings.simulated_seed
        )
    ]
    first = started[0].machine
    for number in range(2, settings.simulated_machines + 1):
        content = {**machine_to_json(first), "name": f"{first.name} {number}"}
        machine_id, seed = f"bench-{number}", settings.simulated_seed + number - 1
        started.append(_start_bench(settings, stack, machine_id, content, seed=seed))
    return started


def _read_content(file: Path) -> Mapping[str, Any]:
    read_machine(file)  # names what is wrong with it
    return json.loads(file.read_text(encoding="utf-8-sig"))


def _start_bench(
    settings: Settings,
    stack: ExitStack,
    machine_id: str,
    content: Mapping[str, Any] | None,
    *,
    seed: int,
) -> ConfiguredMachine:
    try:
        bench = load("truepath.simulators", "bench")(
            machine=content,
            seed=seed,
            speed=settings.simulated_speed,
            faults=settings.simulated_faults,
            hidden=settings.simulated_hidden,
            compensation=settings.simulated_compensation,
        )
    except ValueError as error:
        raise BadInput(f"simulated devices: {error}") from error
    stack.enter_context(bench)
    log.info(
        "simulated devices are up",
        machine=machine_id,
        tracker=bench.tracker_options,
        motion=bench.motion_options,
    )
    config = CellConfig(
        "streaming",
        bench.tracker_options,
        "modbus",
        bench.motion_options,
        thermometer_driver="modbus-registers",
        thermometer_options=bench.thermometer_options,
    )
    machine = machine_from_json(bench.machine)
    return ConfiguredMachine(machine_id, machine, config, control=bench)


@contextmanager
def _redirect_temporary_files(folder: Path) -> Iterator[None]:
    """The system's temporary folder may be in memory."""
    folder.mkdir(exist_ok=True)
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


def _print_addresses(settings: Settings, address: str) -> None:
    devices = "simulated" if settings.simulated else "as set up"
    print(
        f"Truepath {version('truepath')}, devices {devices}",
        f"  page       {address}/",
        f"  interface  {address}/docs",
        f"  data       {settings.data_dir}",
        sep="\n",
        flush=True,
    )
