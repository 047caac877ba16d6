"""The commands on installed plug-ins: `drivers`, `formats`, `effects`, `plugins`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from truepath.cli.terminal import (
    Config,
    DataDir,
    Json,
    print_json,
)
from truepath.errors import BadInput

if TYPE_CHECKING:
    from truepath.device_options import DriverOption
    from truepath.machine_settings import MachineSettings
    from truepath.operation.plugin_list import PluginEntry


def drivers(json: Json = False) -> None:
    """The installed drivers, and the options that settings may give each."""
    from truepath.device_options import DEVICES, read_options
    from truepath.plugins import gather

    found = {word: gather(group, read_options) for word, group in DEVICES.items()}
    if json:
        print_json(
            {
                word: {
                    name: [_describe(option) for option in options]
                    for name, options in of_word.items()
                }
                for word, of_word in found.items()
            }
        )
        return
    for word, of_word in found.items():
        for name, options in of_word.items():
            print(f'{word}_driver = "{name}", {word}_options:')
            for one in options:
                usual = "has to be given" if one.is_required else repr(one.default)
                print(f"  {one.name:24} {one.kind:24} {usual}")


def _describe(option: DriverOption) -> dict[str, object]:
    described: dict[str, object] = {"name": option.name, "type": option.kind}
    if option.is_required:
        return described | {"required": True}
    return described | {"required": False, "default": option.default}


def formats(json: Json = False) -> None:
    """The formats of compensation files, and what each carries."""
    from truepath.compensation.format_registry import describe_format, list_formats

    found = [describe_format(name, kind) for name, kind in list_formats().items()]
    if json:
        print_json({"formats": found})
        return
    for one in found:
        tried = "" if one["sign"]["verified"] else "; the sign is to be tried"
        print(f"{one['name']}: {one['control']}, {one['most_rows']} rows{tried}")
        print(f"  carries      {one['carries']}")
        print(f"  not carried  {one['not_carried']}")
        for key, words in one["choices"].items():
            by_axis = (
                f", or X={words[0]},Y={words[-1]}" if key in one["by_axis"] else ""
            )
            print(f"  --{key.replace('_', '-')}  {', '.join(words)}{by_axis}")


def effects(json: Json = False) -> None:
    """The effects that discovery looks for, their causes and remedies."""
    from truepath.kinematics.effects.family import describe_family, list_families

    found = [describe_family(family) for family in list_families()]
    if json:
        print_json({"effects": found})
        return
    for one in found:
        ends = "" if one["enters_analyse"] else "; ends with its Run, not for --model"
        print(f"{one['name']}: {one['title']}, of the {one['of']}{ends}")
        for key in ("cause", "looks_like", "remedy"):
            print(f"  {key.replace('_', ' '):11} {one[key]}")


def plugins(
    check: Annotated[
        bool,
        typer.Option("--check", help="Hold each against its interface."),
    ] = False,
    device: Annotated[
        str,
        typer.Option(
            metavar="WORD",
            help="With --check: the driver of tracker, motion or thermometer of the "
            "settings, at its device. motion MOVES the axes by 2 mm: clear them first.",
        ),
    ] = "",
    config: Config = None,
    data_dir: DataDir = None,
    json: Json = False,
) -> int:
    """Every plug-in: drivers, effects, dialects, formats; whose they are.

    The exit status is 1 where one cannot be used, or does not keep its interface.
    """
    from dataclasses import asdict

    from truepath.operation.plugin_list import (
        check_device,
        list_excluded,
        list_plugins,
    )

    if device and not check:
        raise BadInput("--device needs --check as well")
    if device:
        found = [check_device(device, _find_machine(config, data_dir))]
    else:
        found = list(list_plugins(checks=check))
    left_out = list_excluded()
    if json:
        print_json({"plugins": [asdict(one) for one in found], "left_out": left_out})
    else:
        for one in found:
            _print_plugin(one, "not checked: needs --device" if check else "")
        for why in left_out:
            print(f"left out: {why}")
    return int(bool(left_out) or not all(one.is_well for one in found))


def _find_machine(config: Config, data_dir: DataDir) -> MachineSettings:
    from truepath.operation.running_service import find_service
    from truepath.settings import load_settings

    settings = load_settings(config, data_dir=data_dir)
    if find_service(settings).is_there:
        raise BadInput("the service holds the devices; end it, then check them")
    machines = list(settings.list_machines().values())
    if len(machines) != 1:
        raise BadInput(
            f"the settings have {len(machines)} machines, 1 can be checked; "
            "set machine_file"
        )
    return machines[0]


def _print_plugin(one: PluginEntry, otherwise: str) -> None:
    whose = f"{one.distribution} {one.version}"
    said = "WRONG" if not one.is_well else "checked" if one.was_checked else otherwise
    version = f"interface {one.interface_version}" if one.interface_version else ""
    print(f"{one.group:21} {one.name:20} {whose:24} {version:12} {said}".rstrip())
    for why in (*([one.fault] if one.fault else []), *one.failures):
        print(f"{'':21} -> {why}")
    if one.unproved:
        print(f"{'':21} not proved: {one.unproved}")
