"""The command on what is installed: `drivers`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from truepath.app.cli.terminal import Json, print_json

if TYPE_CHECKING:
    from truepath.app.device_options import DriverOption


def drivers(json: Json = False) -> None:
    """The installed drivers, and the options that settings may give each."""
    from truepath.app.device_options import DEVICES, read_options
    from truepath.app.plugins import gather

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
