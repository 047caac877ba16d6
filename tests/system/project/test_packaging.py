"""Constraints pin all that is installed; the wheel carries all that is served."""

import ast
import re
import sys
import zipfile
from importlib import metadata
from itertools import takewhile

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

SOURCES = ("app", "drivers", "simulators")
KNOWN = {"truepath", "truepath_drivers", "truepath_simulators"}
KNOWN |= {"psycopg", "distributed", "weasyprint"}  # of an extra, imported with it
KNOWN |= {"hal", "pytest"}  # of what loads that file: LinuxCNC, pytest


@pytest.fixture(scope="module")
def pins(root):
    lines = (root / "constraints.txt").read_text().split()
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
    return {canonicalize_name(n): v for n, v in (line.split("==") for line in lines)}


def required(name, extras):
    """Yield all distributions that one needs, directly or not, in this environment."""
    ahead, seen = [(name, frozenset(extras))], set()
    while ahead:
        name, wanted = ahead.pop()
        if (name, wanted) in seen:
            continue
        seen.add((name, wanted))
        for text in metadata.distribution(name).requires or []:
            need = Requirement(text)
            marks = [{"extra": extra} for extra in (*wanted, "")]
            if need.marker and not any(need.marker.evaluate(m) for m in marks):
                continue
            ahead.append((canonicalize_name(need.name), frozenset(need.extras)))
    return {name for name, _ in seen}


def test_constraints_pin_everything_that_is_needed_as_it_is_installed(pins):
    needed = required("truepath", {"dev", "pg"}) - {"truepath"}
    assert needed <= set(pins), f"not pinned: {sorted(needed - set(pins))}"
    assert set(pins) <= needed, f"pinned, not needed: {sorted(set(pins) - needed)}"

    def installed(name):
        try:
            return metadata.distribution(name).version
        except metadata.PackageNotFoundError:
            return "not installed"

    assert not {n: (v, installed(n)) for n, v in pins.items() if installed(n) != v}


def licence_of(name):
    about = metadata.distribution(name).metadata
    kinds = [line for line in about.get_all("Classifier", []) if "License ::" in line]
    stated = about.get("License-Expression") or about.get("License") or ""
    return about.get("License-Expression") or " ".join(kinds) or stated


def test_what_runs_imports_only_what_is_installed_with_it(root):
    given = required("truepath", set())
    owners = metadata.packages_distributions()
    strange = set()
    for file in (f for room in SOURCES for f in (root / room).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            for name in {n.partition(".")[0] for n in names} - KNOWN:
                found = {canonicalize_name(one) for one in owners.get(name, [name])}
                if name not in sys.stdlib_module_names and not found & given:
                    strange.add(f"{file.relative_to(root)}: {name}")
    assert not strange


def test_nothing_that_runs_has_a_licence_that_binds_the_project(root):
    plain = required("truepath", {"pg", "dask", "pdf"}) - {"truepath"}
    assert not {name for name in plain if not licence_of(name)}
    bound = {n for n in plain if re.search("GPL|GNU|MPL|EUPL|CDDL", licence_of(n))}
    assert bound == {"psycopg", "psycopg-binary", "pyphen"}
    assert not bound & required("truepath", ())
    text = (root / "docs" / "installation.md").read_text()
    assert all(f"`{name}`" in text for name in bound)


def test_hooks_before_a_commit_run_what_make_check_runs(root):
    lines = (root / "Makefile").read_text().partition("\ncheck: ")[2].splitlines()[1:]
    checks = [line.strip() for line in takewhile(lambda line: line, lines)]
    (local,) = yaml.safe_load((root / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    entries = [hook["entry"] for hook in local["hooks"]]
    assert entries == [line.replace("$(BIN)", ".venv/bin") for line in checks]


def test_the_wheel_holds_the_rooms_and_their_plug_ins(wheel, project_files, root):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        packed = {name: archive.read(name).decode("latin-1") for name in names}
    texts = [text for n, text in packed.items() if n.endswith("licenses/LICENSE")]
    assert texts == [(root / "LICENSE").read_text()]
    places = [path.relative_to(root).parts for path in project_files]
    wanted = {"/".join(names) for room, *names in places if room in SOURCES}
    assert wanted <= packed.keys(), f"left out: {sorted(wanted - packed.keys())}"
    first = {name.split("/")[0] for name in packed}
    rooms = {"truepath", "truepath_drivers", "truepath_simulators"}
    assert {name for name in first if not name.endswith(".dist-info")} == rooms
    (points,) = (text for n, text in packed.items() if n.endswith("entry_points.txt"))
    groups = set(re.findall(r"^\[(.+)\]$", points, re.MULTILINE))
    kinds = ("trackers", "motion_controllers", "simulators")
    assert groups >= {"console_scripts", *(f"truepath.{kind}" for kind in kinds)}


def test_every_entry_point_loads():
    groups = metadata.distribution("truepath").entry_points
    assert groups
    for point in groups:
        loaded = point.load()
        # pytest takes a module of hooks and fixtures, everybody else a factory.
        hook = loaded.pytest_configure if point.group == "pytest11" else loaded
        assert callable(hook), point
