"""Settings of the service: environment (`TRUEPATH_…`) over a TOML file over defaults.

A setting is spelled the same in both: `port = 8411` in the file is
`TRUEPATH_PORT=8411`. Tables (`tracker_options`) are JSON in the environment. The file
is the one named by `--config`, else by `TRUEPATH_CONFIG`, else `truepath.toml` in the
user's configuration folder where that exists.
"""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import platformdirs
from pydantic import (
    AfterValidator,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)
from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

from truepath.errors import BadInput
from truepath.machine_settings import (
    ONLY_MACHINE,
    DeviceConfiguration,
    MachineSettings,
    check_machine_id,
)
from truepath.service_log import LogFile

_DASK = "dask://"


def _check_network(text: str) -> str:
    try:
        ipaddress.ip_network(text)
    except ValueError as error:
        raise ValueError(
            f"{error}: give an address or a network, such as 10.0.0.0/8"
        ) from error
    return text


_Network = Annotated[str, AfterValidator(_check_network)]


class Settings(DeviceConfiguration, BaseSettings):
    """Everything that can be set. Built by `load_settings`, then never changed."""

    model_config = SettingsConfigDict(
        env_prefix="TRUEPATH_",
        extra="forbid",
        frozen=True,
        str_max_length=4096,
        use_attribute_docstrings=True,
    )

    host: str = Field("127.0.0.1", min_length=1)
    """Address where the service listens; `0.0.0.0` for all of this computer."""
    port: int = Field(8411, ge=0, le=65535)
    """0 lets the system choose; the address is printed."""
    allow_plain_http: bool = False
    """Listen beyond this computer although nothing is encrypted."""
    log_in: Literal["beyond-this-computer", "always", "never"] = "beyond-this-computer"
    """Who has to log in: nobody as long as only this computer can reach the service.
    `never` is for a container whose port is published on this computer only, or behind
    a proxy that asks for a log-in."""
    session_hours: float = Field(12.0, gt=0, le=720)
    """How long a log-in lasts."""
    allow_arming_by_key: bool = False
    """Let a program with an API key set the machine in motion."""
    arm_token_s: float = Field(60.0, ge=5, le=3600)
    """How long a person may look at what will move before the machine is armed."""
    temperature_drift_limit_degC: float | None = Field(  # noqa: N815
        None, gt=0, le=20
    )
    """By how much a thermometer may change in 10 minutes for a machine to be armed.
    Without it a change of more than 1 °C is shown and refuses nothing."""
    tls_cert: Path | None = None
    """Certificate of this computer (PEM), with those that lead to its root."""
    tls_key: Path | None = None
    """Its private key (PEM). Both or neither."""
    trusted_hosts: tuple[str, ...] = ()
    """Names browsers may call this computer by, beside localhost and IP addresses."""
    trusted_proxies: tuple[_Network, ...] = ()
    """Addresses or networks of the proxies whose `X-Forwarded-…` headers are trusted;
    those of anybody else are ignored."""
    root_path: str = Field("", pattern=r"^(/[\w.~-]+)*/?$")
    """Path at which a reverse proxy shows the service, such as `/truepath`; one that a
    trusted proxy names in `X-Forwarded-Prefix` counts before it."""

    data_dir: Path = Field(
        default_factory=lambda: platformdirs.user_data_path("truepath", appauthor=False)
    )
    """Folder of Runs, results and the SQLite catalogue; by default in the user's."""
    database_url: str = ""
    """Empty: SQLite in `data_dir`. PostgreSQL: `postgresql+psycopg://user@host/name`."""
    database_password_file: Path | None = None
    """Where the password of `database_url` is, to keep it out of the environment."""

    simulated: bool = False
    """Bring simulated devices up, and measure on them."""
    simulated_speed: float = Field(1.0, gt=0, le=100)
    """Their clock, as a multiple of real time."""
    simulated_seed: int = Field(1, ge=0)
    """Which simulated machine it is."""
    simulated_faults: tuple[str, ...] = ()
    """What goes wrong; `truepath simulate --help` lists faults."""
    simulated_hidden: tuple[str, ...] = ()
    """Effects that the model lacks, to be found: `name[*size_um]`, or JSON objects."""
    simulated_compensation: tuple[Path, ...] = ()
    """Compensation files that the simulated controller has: of one maker's form."""

    simulated_machines: int = Field(1, ge=1, le=64)
    """Benches of one kind of machine, told apart by their seeds and names."""

    machine_file: Path | None = None
    """`machine.json` of a single machine, whose devices are set beside it. Without a
    machine the service only analyses."""
    machines: dict[str, MachineSettings] = Field(default_factory=dict)
    """Tables of several machines, by their identifiers: `[machines.mill-3]`."""

    analysis_workers: int = Field(1, ge=1, le=64)
    """Jobs that compute at one time."""
    executor: Literal["processes", "dask"] = "processes"
    """Who computes what can be cut into blocks, such as Monte Carlo trials.

    `dask://host:8786` stands for `dask` and that scheduler."""
    executor_workers: int = Field(0, ge=0, le=1024)
    """Blocks under way together; 0 is one a core, or a thread of the Dask cluster."""
    dask_scheduler: str = ""
    """Address of the Dask scheduler, `tcp://host:8786`."""
    max_upload_mb: int = Field(512, ge=1, le=65536)
    """Size of an uploaded bundle."""
    upload_memory_mb: int = Field(2048, ge=64, le=1 << 20)
    """Memory that reading one uploaded bundle may take, in a process of its own."""
    max_streams: int = Field(64, ge=1, le=10_000)
    """Event streams open at one time; each browser tab holds one."""

    keep_runs_days: int = Field(0, ge=0, le=36500)
    """Days after which a Run that no result was made from is deleted; 0: never."""
    keep_results_days: int = Field(0, ge=0, le=36500)
    """Days after which a job is deleted with its answer; 0: never. What a machine's
    history, a certificate or another job depends on stays."""

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """What is logged, and all that is graver."""
    log_format: Literal["console", "json"] = "console"
    """Lines on standard error: to read, or JSON."""
    log_file: Path | None = None
    """File that keeps the lines as JSON as well."""
    log_file_mb: float = Field(10.0, gt=0, le=10_000)
    """Size at which a log file is set aside, `FILE.1`, and another one begun."""
    log_files: int = Field(5, ge=1, le=1000)
    """Number of log files that are kept beside the newest."""

    @model_validator(mode="before")
    @classmethod
    def _split_executor(cls, given: dict[str, Any]) -> dict[str, Any]:
        executor, known = given.get("executor"), given.get("dask_scheduler")
        if not (isinstance(executor, str) and executor.startswith(_DASK)):
            return given
        scheduler = f"tcp://{executor.removeprefix(_DASK)}"
        if known and known != scheduler:
            raise ValueError(
                f"executor {executor} and dask_scheduler {known} name two schedulers; "
                "give one of them"
            )
        return {**given, "executor": "dask", "dask_scheduler": scheduler}

    @model_validator(mode="after")
    def _require_what_fits_together(self) -> Self:
        if not (self.is_loopback or self.tls_cert or self.allow_plain_http):
            raise ValueError(
                f"host {self.host} can be reached from other computers, without "
                "encryption; give tls_cert and tls_key (`truepath tls create` makes "
                "them), or accept the risk with --allow-plain-http"
            )
        if self.machine_file is not None and ONLY_MACHINE in self.machines:
            raise ValueError(
                f"machine_file and [machines.{ONLY_MACHINE}] are two machines of one "
                "identifier; give the second another"
            )
        if self.simulated_machines > 1 and self.machines:
            raise ValueError(
                "simulated_machines stands beside [machines]; of these each has its "
                "own bench"
            )
        if self.simulated_machines > 1 and not self.simulated:
            raise ValueError("simulated_machines needs simulated = true")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key go together; give both or neither")
        return self

    @field_validator("machines")
    @classmethod
    def _require_identifiers(
        cls, given: dict[str, MachineSettings]
    ) -> dict[str, MachineSettings]:
        for machine_id in given:
            check_machine_id(machine_id)
        return given

    def list_machines(self) -> dict[str, MachineSettings]:
        """Machines by their identifiers, the single one first."""
        if self.machine_file is None:
            return dict(self.machines)
        stated = self.model_dump(include=set(MachineSettings.model_fields))
        return {ONLY_MACHINE: MachineSettings(**stated), **self.machines}

    @property
    def log(self) -> LogFile | None:
        """The log file, if one is kept."""
        if self.log_file is None:
            return None
        return LogFile(self.log_file, int(self.log_file_mb * 1e6), self.log_files)

    @property
    def log_in_required(self) -> bool:
        """Whether requests need a login."""
        if self.log_in == "beyond-this-computer":
            return not self.is_loopback
        return self.log_in == "always"

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can reach the service."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def database(self) -> str:
        """The catalogue's address, with its password: not for logs."""
        if not self.database_url:
            return f"sqlite:///{self.data_dir / 'catalogue.sqlite'}"
        if self.database_password_file is None:
            return self.database_url
        return _insert_password(self.database_url, self.database_password_file)

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Sources in order of precedence: given, environment, file."""
        return init_settings, env_settings, TomlConfigSettingsSource(settings_cls)


def load_settings(config: Path | None = None, **given: Any) -> Settings:
    """Settings; `given` (command line) overrides environment, then file.

    A given value of None counts as not given. Raises BadInput naming the setting.
    """
    file = config or _find_default_file()
    wanted = {key: value for key, value in given.items() if value is not None}
    try:
        return _read_file_below(file)(**wanted)
    except ValidationError as error:
        raise BadInput(_describe_error(error)) from error
    except ValueError as error:  # a table in the environment that is not JSON, bad TOML
        raise BadInput(f"settings{f' ({file})' if file else ''}: {error}") from error


def _find_default_file() -> Path | None:
    named = os.environ.get("TRUEPATH_CONFIG")
    if named:
        return Path(named)
    usual = platformdirs.user_config_path("truepath", appauthor=False) / "truepath.toml"
    return usual if usual.is_file() else None


def _read_file_below(file: Path | None) -> type[Settings]:
    if file is None:
        return Settings
    if not file.is_file():
        raise BadInput(f"{file}: no such settings file; check --config")

    class Stored(Settings):
        model_config = SettingsConfigDict(toml_file=file)

    return Stored


def _insert_password(url: str, file: Path) -> str:
    try:
        password = file.read_text(encoding="utf-8").strip()
        address = make_url(url).set(password=password)
    except (OSError, ArgumentError) as error:
        raise BadInput(
            f"setting database_password_file or database_url: {error}"
        ) from error
    return address.render_as_string(hide_password=False)


def _describe_error(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    name = ".".join(str(part) for part in first["loc"])
    text = str(first["msg"]).removeprefix("Value error, ")
    return f"setting {name}: {text}" if name else text
