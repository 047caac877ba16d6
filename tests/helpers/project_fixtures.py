"""What the tests of the project itself share: its files, as git sees them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = {"pyproject.toml", "README.md", "LICENSE", "app", "drivers", "simulators"}


@pytest.fixture(scope="session")
def root():
    return ROOT


@pytest.fixture(scope="session")
def project_files(root):
    """Every file that is in git or about to be: nothing that git ignores."""
    words = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.check_output(words, cwd=root, text=True)
    files = {root / name for name in listed.split("\0") if name}
    return sorted(path for path in files if path.is_file())


@pytest.fixture(scope="session")
def wheel(tmp_path_factory, project_files, root):
    """Build the wheel from a copy of the files git knows, without the network."""
    source = tmp_path_factory.mktemp("source")
    for path in project_files:
        if path.relative_to(root).parts[0] in SHIPPED:
            copy = source / path.relative_to(root)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    target = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps"]
    command += ["--no-build-isolation", "--wheel-dir", str(target), str(source)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return next(target.glob("truepath-*.whl"))
