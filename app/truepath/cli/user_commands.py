"""Users, API keys and the audit log, on the computer of the service itself."""

from __future__ import annotations

import getpass
import json as json_module
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truepath.cli.terminal import Config, DataDir, Json, print_json
from truepath.errors import BadInput, TruepathError

if TYPE_CHECKING:
    from truepath.catalogue.database import Database
    from truepath.users.roles import Role

users = typer.Typer(help="Who may log in, and with which role.", no_args_is_help=True)
keys = typer.Typer(help="API keys of programs.", no_args_is_help=True)
audit = typer.Typer(help="The audit log: who did what.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(metavar="NAME")]
UserRole = Annotated[
    str,
    typer.Option(
        "--role",
        metavar="ROLE",
        help="viewer, operator, metrologist or administrator.",
    ),
]
PasswordStdin = Annotated[
    bool,
    typer.Option(
        "--password-stdin", help="Read the password from standard input, one line."
    ),
]


@users.command("add")
def add_user(
    name: Name,
    role: UserRole,
    password_stdin: PasswordStdin = False,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Add a user; the password is asked for."""
    from truepath.users.accounts import Accounts

    chosen, password = _parse_role(role), _read_password(password_stdin)
    with _open(config, data_dir) as database:
        Accounts(database).add(name, chosen, password)
        _note(database, f"users add {name}", new={"role": chosen})
    print(f"{name} is {chosen}")


@users.command("list")
def list_users(
    config: Config = None, data_dir: DataDir = None, json: Json = False
) -> None:
    """Name, role and age of every user."""
    from truepath.users.accounts import Accounts

    with _open(config, data_dir) as database:
        found = Accounts(database).list_all()
    if json:
        print_json({"schema": "users/1", "users": [asdict(user) for user in found]})
        return
    for user in found:
        print(f"{user.name:20s} {user.role:14s} since {user.created}")


@users.command("remove")
def remove_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Remove a user and end all sessions."""
    from truepath.users.accounts import Accounts

    with _open(config, data_dir) as database:
        role = Accounts(database).remove(name)
        _note(database, f"users remove {name}", old={"role": role})


@users.command("set-password")
def set_password(
    name: Name,
    password_stdin: PasswordStdin = False,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Give a user another password and end all sessions."""
    from truepath.users.accounts import Accounts

    password = _read_password(password_stdin)
    with _open(config, data_dir) as database:
        Accounts(database).set_password(name, password)
        _note(database, f"users set-password {name}", new={"password": "changed"})


@users.command("set-role")
def set_role(
    name: Name, role: UserRole, config: Config = None, data_dir: DataDir = None
) -> None:
    """Give a user another role, at once."""
    from truepath.users.accounts import Accounts

    chosen = _parse_role(role)
    with _open(config, data_dir) as database:
        before = Accounts(database).set_role(name, chosen)
        change = {"old": {"role": before}, "new": {"role": chosen}}
        _note(database, f"users set-role {name}", **change)


@keys.command("create")
def create_key(
    name: Name,
    role: Annotated[
        str,
        typer.Option(metavar="ROLE", help="viewer, service or metrologist."),
    ] = "service",
    days: Annotated[
        float | None, typer.Option(min=0.001, help="Until it ends; else never.")
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Make an API key and print it, this once."""
    from truepath.users.tokens import Tokens

    chosen = _parse_role(role)
    with _open(config, data_dir) as database:
        token = Tokens(database, session_s=0.0).create_key(name, chosen, days)
        _note(database, f"keys create {name}", new={"role": chosen})
    print(token)


@keys.command("list")
def list_keys(
    config: Config = None, data_dir: DataDir = None, json: Json = False
) -> None:
    """Name, role and end of every API key."""
    from truepath.users.tokens import Tokens

    with _open(config, data_dir) as database:
        found = Tokens(database, session_s=0.0).list_keys()
    if json:
        print_json({"schema": "keys/1", "keys": [asdict(key) for key in found]})
        return
    for key in found:
        left = key.expires_in_s
        end = "no end" if left is None else f"{max(left, 0.0) / 86400.0:.1f} days left"
        print(f"{key.name:20s} {key.role:14s} since {key.created}, {end}")


@keys.command("revoke")
def revoke_key(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """End an API key at once."""
    from truepath.users.tokens import Tokens

    with _open(config, data_dir) as database:
        Tokens(database, session_s=0.0).revoke_key(name)
        _note(database, f"keys revoke {name}")


@audit.command("verify")
def verify_audit(config: Config = None, data_dir: DataDir = None) -> None:
    """Whether a row was changed or is missing; each such row is named."""
    from truepath.users.audit import AuditLog

    with _open(config, data_dir) as database:
        log = AuditLog(database)
        seq, digest = log.read_head()
        wrong = log.verify()
    if wrong:
        raise AuditBroken(f"the audit log is not as it was written: {'; '.join(wrong)}")
    print(f"{seq} rows, each as it was written; the hash of the newest is {digest}")


@audit.command("export")
def export_audit(
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Else standard output."),
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """All rows as JSON, one a line, the oldest first."""
    from truepath.users.audit import AuditLog, encode_row

    with _open(config, data_dir) as database:
        rows = AuditLog(database).read()
        lines = (json_module.dumps(encode_row(row), ensure_ascii=False) for row in rows)
        if output is None:
            for line in lines:
                print(line)
            return
        with output.open("w", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in lines)


class AuditBroken(TruepathError):
    """The audit log was changed by another program."""


@contextmanager
def _open(config: Path | None, data_dir: Path | None) -> Iterator[Database]:
    """A service may run meanwhile."""
    from truepath.catalogue.database import Database
    from truepath.settings import load_settings

    settings = load_settings(config, data_dir=data_dir)
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    database = Database(settings.database)
    try:
        database.migrate()
        yield database
    finally:
        database.close()


def _note(database: Database, what: str, **change: Any) -> None:
    from truepath.users.audit import AuditLog, Entry

    who = getpass.getuser()
    AuditLog(database).append(
        Entry(who, "", "command line", "", what, "done", **change)
    )


def _parse_role(role: str) -> Role:
    from truepath.users.roles import Role

    try:
        return Role(role)
    except ValueError as error:
        raise BadInput(f"--role {role}: not one of {', '.join(Role)}") from error


def _read_password(from_stdin: bool) -> str:
    if from_stdin:
        return sys.stdin.readline().rstrip("\r\n")
    if not sys.stdin.isatty():
        raise BadInput("no terminal to ask for a password; give --password-stdin")
    password = getpass.getpass("password: ")
    if password != getpass.getpass("again: "):
        raise BadInput("the two passwords differ")
    return password
