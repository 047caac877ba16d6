"""Write what an image holds, in MB, as the table of docs/installation.md.

usage: python list_contents.py FOLDER   (where `buildah mount` shows the image)
"""

from __future__ import annotations

import sys
from pathlib import Path

_NAMED_FROM_MB = 5.0


def count_mb(path: Path) -> float:
    """Return what a file, or a folder with what is in it, takes on the disk."""
    below = path.rglob("*") if path.is_dir() and not path.is_symlink() else (path,)
    return sum(file.lstat().st_blocks * 512 for file in below) / 1e6


def measure_contents(root: Path) -> dict[str, float]:
    """Return MB by name, the largest library first, what is small in one sum."""
    (packages,) = root.glob("opt/truepath/lib/python3*/site-packages")
    sizes: dict[str, float] = {}
    for path in packages.iterdir():
        name = path.name.removesuffix(".libs")
        sizes[name] = sizes.get(name, 0.0) + count_mb(path)
    named = {k: mb for k, mb in sizes.items() if mb >= _NAMED_FROM_MB}
    largest_first = dict(sorted(named.items(), key=lambda item: -item[1]))
    rest = {"other libraries": sum(sizes.values()) - sum(named.values())}
    ours = count_mb(root / "opt" / "truepath")
    return largest_first | rest | {"base: Debian and Python": count_mb(root) - ours}


def main(root: Path) -> None:
    """Print the table."""
    contents = measure_contents(root)
    print("| part | MB |\n| --- | --- |")
    for name, mb in contents.items():
        print(f"| {name} | {mb:.0f} |")
    print(f"| in all | {sum(contents.values()):.0f} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
