"""README and docs: every link leads somewhere, every command is there."""

import re
import shlex
import subprocess
import sys
from importlib.util import find_spec

import pytest

from truepath.files.earlier.verdict import SENTENCES, STATED
from truepath.service.api.application import create_application

PARTS = {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs"}
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#+\s+(.*)$", re.MULTILINE)
OF_DEVICES = (*range(1, 24), 30, 31)  # rows of reliability.md


@pytest.fixture(scope="module")
def documents(project_files, root):
    texts = (path for path in project_files if path.suffix == ".md")
    return [path for path in texts if path.relative_to(root).parts[0] in PARTS]


def anchor(heading):
    """Spell a heading as the usual renderers do in links."""
    kept = re.sub(r"[^\w\- ]", "", heading.strip().lower().replace("`", ""))
    return kept.replace(" ", "-")


def test_every_link_leads_to_a_file_and_a_heading(documents, root):
    broken = []
    for document in documents:
        for link in LINK.findall(FENCE.sub("", document.read_text())):
            if re.match(r"[a-z]+:", link):
                continue
            name, _, heading = link.partition("#")
            target = (document.parent / name).resolve() if name else document
            if not target.exists():
                broken.append(f"{document.relative_to(root)}: {link}")
                continue
            headings = HEADING.findall(target.read_text()) if heading else ()
            if heading and heading not in map(anchor, headings):
                broken.append(f"{document.relative_to(root)}: no heading {link}")
    assert not broken, "\n".join(broken)


def test_every_document_can_be_reached_from_the_index(documents, root):
    reached, ahead = set(), [root / "README.md", root / "docs" / "index.md"]
    while ahead:
        document = ahead.pop()
        reached.add(document)
        links = (link.partition("#")[0] for link in LINK.findall(document.read_text()))
        near = {(document.parent / link).resolve() for link in links if link}
        ahead += [p for p in near - reached if p.suffix == ".md" and p.exists()]
    assert set(documents) <= reached


ROOMS = "app|drivers|simulators|tests|validation|benchmarks|docker|docs"
PLACE = re.compile(rf"`((?:{ROOMS})/[\w./-]*\w)/?`")


def test_every_file_and_folder_that_documents_name_exists(documents, root):
    ignored = (root / ".gitignore").read_text()
    missing = [
        f"{document.relative_to(root)}: {place}"
        for document in documents
        for place in PLACE.findall(document.read_text())
        if not (root / place).exists() and place not in ignored
    ]
    assert not missing, "\n".join(missing)


def test_the_way_of_a_sample_and_what_is_below_the_service_name_files_that_exist(root):
    """The table in architecture.md names a file in each row, and files beside it."""
    text = (root / "docs" / "architecture.md").read_text()
    section = text.partition("## One tracker sample")[2].partition("\n## ")[0]
    rows = [row for row in section.splitlines() if re.match(r"\| \d", row)]
    assert len(rows) >= 10
    for row in rows:
        first, *beside = re.findall(r"`([\w./]+\.py)`", row)
        assert (root / first).is_file(), first
        for name in beside:
            folder = root if "/" in name else (root / first).parent
            assert (folder / name).is_file(), name
    for heading in ("A job, an analysis", "Where logic lives"):  # below the service
        section = text.partition(f"## {heading}")[2].partition("\n## ")[0]
        named = re.findall(r"`([\w./-]+(?:/|\.py)[\w.-]*)`", section)
        assert len(named) > 10
        near = (root / "app" / "truepath", root)
        assert not [n for n in named if not any((place / n).exists() for place in near)]


def test_the_tree_of_rooms_is_the_one_on_disk(root):
    text = (root / "docs" / "architecture.md").read_text()
    tree = text.partition("```text\n")[2].partition("\n```")[0]
    named, ahead = set(), {}
    for line in tree.splitlines():
        indent = len(line) - len(line.lstrip())
        for name in re.split(r" {2,}", line.strip())[0].split(" "):
            place = ahead.get(indent - 2, root) / name
            assert place.exists(), f"not there: {line}"
            named.add(place)
        ahead[indent] = place
    rooms = root / "app" / "truepath"
    packages = [*rooms.glob("*/__init__.py"), *rooms.glob("*/*/__init__.py")]
    there = {p.parent for p in packages if p.parent.parent.name != "cli"}
    assert not there - named, "left out"


def test_the_new_import_names_of_the_changelog_are_there(root):
    text = (root / "CHANGELOG.md").read_text()
    table = text.partition("| for | before | now |")[2].partition("\n\n")[0]
    names = re.findall(r"\| `(truepath[\w.]+)`[^|]*\|$", table, re.MULTILINE)
    assert len(names) > 20
    assert not [name for name in names if find_spec(name) is None]


def commands(documents):
    """Return (document, words) of every shell line of the documents."""
    for document in documents:
        for language, body in FENCE.findall(document.read_text()):
            if language in {"sh", "bash", "shell"}:
                for line in body.replace("\\\n", " ").splitlines():
                    words = shlex.split(line, comments=True)
                    if words:
                        yield document, words


def test_every_make_target_and_command_of_the_documents_exists(documents, root):
    text = (root / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):(?!=)", text, re.MULTILINE))
    asked = {w[1] for _, w in commands(documents) if w[0] == "make" and len(w) > 1}
    assert asked
    assert asked <= targets
    helps = {}

    def help_of(*name):
        if name not in helps:
            program = root / ".venv" / "bin" / "truepath"
            wide = {"COLUMNS": "200", "TERM": "dumb", "PATH": ""}
            ask = [program, *name, "--help"]
            helps[name] = subprocess.check_output(ask, text=True, env=wide)
        return helps[name]

    lines = [w for _, w in commands(documents) if w[0].endswith("truepath")]
    assert lines
    for words in lines:
        offered = help_of(words[1])
        if " COMMAND " in offered and len(words) > 2:
            offered = help_of(*words[1:3])
        for option in (w.partition("=")[0] for w in words[2:] if w.startswith("-")):
            assert re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", offered), words


def test_every_route_of_the_documents_exists_and_none_is_left_out(root):
    routes = {
        (method.upper(), path)
        for path, methods in create_application(None).openapi()["paths"].items()
        for method in methods
    }
    text = (root / "docs" / "rest-api.md").read_text()
    named = set(re.findall(r"`(GET|POST|DELETE|PUT|PATCH) (/[^` ]*)`", text))
    assert named <= routes, f"not there: {sorted(named - routes)}"
    assert not routes - named


@pytest.mark.parametrize("name", ["addresses", "commands", "faults"])
def test_tables_that_scripts_write_are_up_to_date(name, root):
    script = root / "docs" / "write_tables.py"
    words = [sys.executable, str(script), "--check", name]
    assert not subprocess.run(words, check=False).returncode, "docs/write_tables.py"


def test_every_reason_of_a_verdict_is_explained_to_the_operator(root):
    page = (root / "docs" / "verdict.md").read_text()
    assert not [kind for kind in {*SENTENCES} - {STATED} if f"| `{kind}` |" not in page]


def test_the_page_of_faults_is_that_of_the_marks_and_all_of_devices_have_tests(root):
    script = root / "docs" / "write_reliability.py"
    checked = subprocess.run([sys.executable, str(script), "--check"], check=False)
    assert checked.returncode == 0, "python docs/write_reliability.py writes it"
    page = (root / "docs" / "reliability.md").read_text(encoding="utf-8")
    for number in OF_DEVICES:
        assert re.search(rf"^\| {number} \| .*::test_", page, re.MULTILINE), number
