"""A unit for systemd that starts the service, watches it and ends it in order."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

_UNIT = """\
[Unit]
Description=Truepath, calibration of machine tools
Documentation=https://www.freedesktop.org/software/systemd/man/systemd.service.html
After=network-online.target time-sync.target
Wants=network-online.target
StartLimitIntervalSec=300
StartLimitBurst=5

[Service]
# READY when it answers; a sign of life from its event loop, else it is started again.
Type=notify
NotifyAccess=main
WatchdogSec=30
Restart=on-failure
RestartSec=2
TimeoutStartSec=300

# SIGTERM goes to the service alone: it has its cell hold the feed before all else.
# What is left after the time is killed.
KillMode=mixed
TimeoutStopSec=30

ExecStart={command}
User={user}
Environment=OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
SupplementaryGroups=dialout
UMask=0027

# The cell reads 500 samples a second: it may not be the first that the kernel ends.
OOMPolicy=continue
OOMScoreAdjust=-500
LimitNOFILE=8192

StateDirectory={state}
ReadWritePaths={writable}
ProtectSystem=strict
ProtectHome={protect_home}
PrivateTmp=yes
NoNewPrivileges=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectControlGroups=yes
RestrictSUIDSGID=yes
LockPersonality=yes
RestrictRealtime=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
CapabilityBoundingSet=

[Install]
WantedBy=multi-user.target
"""
_HOMES = ("/home", "/root", "/run/user")


@dataclass(frozen=True, slots=True)
class UnitOrder:
    """Content of the unit.

    program : the `truepath` of the installation, as an absolute path
    config : file of settings, None for the defaults
    data_dir : where the service writes; log_dir : where its log file is, if elsewhere
    user : account of the service
    """

    program: Path
    config: Path | None
    data_dir: Path
    log_dir: Path | None
    user: str


def write_unit(order: UnitOrder) -> str:
    """Text of the unit file."""
    words = [str(order.program), "serve"]
    if order.config is not None:
        words += ["--config", str(order.config)]
    words += ["--data-dir", str(order.data_dir)]
    folders = [order.data_dir, *([order.log_dir] if order.log_dir else [])]
    places = [order.program, *folders, *([order.config] if order.config else [])]
    in_home = any(str(place).startswith(_HOMES) for place in places)
    return _UNIT.format(
        command=" ".join(_quote(word) for word in words),
        user=order.user,
        state="truepath",
        # "-" lets the service start where the folder is still to be made.
        writable=" ".join(_quote(f"-{folder}") for folder in dict.fromkeys(folders)),
        # Read-only: an installation below a home has to be read.
        protect_home="read-only" if in_home else "yes",
    )


def _quote(word: str) -> str:
    """With `%` and `$` escaped for systemd."""
    return shlex.quote(word).replace("%", "%%").replace("$", "$$")
