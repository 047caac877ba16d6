"""The command on the formats of compensation files: `formats`."""

from __future__ import annotations

from truepath.app.cli.terminal import Json, collect_seldom, print_json


def formats(json: Json = False) -> None:
    """The formats of compensation files, and what each carries."""
    collect_seldom()
    from truepath.app.compensation.installed import describe_format, list_formats

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
