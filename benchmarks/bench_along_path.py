"""The direction of travel against deviations across the path only, on corner paths.

The same recordings of random machines, solved both ways; left is the mean error that
compensation would leave in the volume. The comparison itself is the validation's.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

import along_the_path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=along_the_path.MACHINES)
    print(along_the_path.summary(along_the_path.outcomes(parser.parse_args().machines)))


if __name__ == "__main__":
    main()
