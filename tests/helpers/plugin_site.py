"""Distributions of somebody else, installed for one test into a folder of its own."""

import sys
from textwrap import dedent

NAME = "hostile-plugins 1.2"


def install(site, entry_points, **modules):
    """Install NAME with modules of this source; return its folder, for `sys.path`."""
    info = site / "hostile_plugins-1.2.dist-info"
    info.mkdir(parents=True)
    name, version = NAME.split()
    stated = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    (info / "METADATA").write_text(stated)
    lines = []
    for group, points in entry_points.items():
        lines += [f"[truepath.{group}]", *(f"{n} = {v}" for n, v in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for module, source in modules.items():
        sys.modules.pop(module, None)  # of a test before
        (site / f"{module}.py").write_text(dedent(source))
    return site
