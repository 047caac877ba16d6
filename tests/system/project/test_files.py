"""What must and must not be in the files of the project."""

import ast
import re

import pytest

# In pieces, so that this file does not hold what it looks for.
FORBIDDEN = re.compile(
    "|".join(
        [
            r"https?://[^ \"]*(/sim" r"ple/|/pack" r"ages/|regi" r"stry\.|fi" r"les\.)",
            r"\"reso" r"lved\": *\"http",
            r"(?<![\w.])/(wo" r"rk|ro" r"ot|ho" r"me)/\w",
            r"/tmp/ba" r"sh_jobs",
        ]
    )
)
TO_DO = re.compile(r"\b(TO" r"DO|FIX" r"ME|X" r"XX|HA" r"CK)\b")


def test_no_file_names_a_registry_a_local_path_or_what_is_to_do(project_files, root):
    found = [
        f"{path.relative_to(root)}:{number}: {line.strip()[:80]}"
        for path in project_files
        if not path.name.endswith(".min.js") and "vendor" not in path.parts
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1)
        if FORBIDDEN.search(line) or (path.suffix == ".py" and TO_DO.search(line))
    ]
    assert not found, "\n".join(found)


def test_no_file_is_larger_than_a_page_needs(project_files, root):
    large = [
        f"{path.relative_to(root)}: {path.stat().st_size} bytes"
        for path in project_files
        if path.stat().st_size > 1_500_000 and "vendor" not in path.parts
    ]
    assert not large, "\n".join(large)


@pytest.fixture(scope="module")
def code(project_files, root):
    rooms = tuple(root / room for room in ("app", "drivers", "simulators"))
    ours = [path for path in project_files if path.suffix == ".py"]
    return [path for path in ours if any(map(path.is_relative_to, rooms))]


BUILT_ON = (
    "app/truepath/client",
    "drivers/truepath_drivers/conformance",
    "drivers/truepath_drivers/interfaces",
    "drivers/truepath_drivers/streams",
)


def public_definitions(tree):
    yield "module", tree
    for node in tree.body:
        kinds = (ast.ClassDef, ast.FunctionDef)
        if not isinstance(node, kinds) or node.name.startswith("_"):
            continue
        yield node.name, node
        if isinstance(node, ast.ClassDef):
            yield from (
                (f"{node.name}.{child.name}", child)
                for child in node.body
                if isinstance(child, ast.FunctionDef)
                and not child.name.startswith("_")
                and not overrides(child)
                # A verb of a protocol: its class says what it is.
                and not (ast.unparse(child.body[-1]) == "..." and len(child.body) == 1)
            )


def overrides(function):
    marks = ("override", "setter", "overload")
    return any(mark in ast.dump(d) for d in function.decorator_list for mark in marks)


def test_each_file_and_all_that_others_build_on_say_what_they_are(code, root):
    silent = [
        f"{path.relative_to(root)}: {name}"
        for path in code
        for name, node in public_definitions(ast.parse(path.read_text()))
        if not ast.get_docstring(node)
        and (name == "module" or any(path.is_relative_to(root / b) for b in BUILT_ON))
    ]
    assert not silent, "\n".join(silent)


def test_packages_export_nothing_and_are_called_after_something(code, root):
    empty = {"utils", "common", "helpers", "manager"}
    places = [path.relative_to(root).with_suffix("") for path in code]
    assert not [str(place) for place in places if empty & set(place.parts)]
    busy = [
        str(path.relative_to(root))
        for path in code
        if path.name == "__init__.py"
        and path.parent.name != "client"  # what other programs import
        and len(ast.parse(path.read_text()).body) != 1
    ]
    assert not busy, "an __init__.py holds a docstring and nothing else: " + str(busy)
