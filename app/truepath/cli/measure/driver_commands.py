"""The commands on what is installed: `drivers`, `formats`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truepath.cli.terminal import Json, collect_seldom, print_json

if TYPE_CHECKING:
    from truepath.device_options import DriverOption


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
                print(f"  {one.name:24} {one.kind:24} {_default(one)}")


def _describe(option: DriverOption) -> dict[str, object]:
    described: dict[str, object] = {"name": option.name, "type": option.kind}
    if option.is_required:
        return described | {"required": True}
    return described | {"required": False, "default": option.default}


def _default(option: DriverOption) -> str:
    return "has to be given" if option.is_required else repr(option.default)


def formats(json: Json = False) -> None:
    """The formats of compensation files, and what each carries."""
    collect_seldom()
    from truepath.compensation.installed import describe_format, list_formats

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
