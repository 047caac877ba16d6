"""The page of faults says what the marks of the tests say."""

import subprocess
import sys

import pytest

OF_DEVICES = (*range(1, 24), 30, 31)


@pytest.fixture(scope="module")
def page(root):
    return (root / "docs" / "reliability.md").read_text(encoding="utf-8")


def test_the_page_is_that_of_the_marks(root):
    script = root / "docs" / "write_reliability.py"
    checked = subprocess.run([sys.executable, str(script), "--check"], check=False)
    assert checked.returncode == 0, "python docs/write_reliability.py writes it"


@pytest.mark.parametrize("number", OF_DEVICES)
def test_every_fault_of_devices_has_a_test(page, number):
    (row,) = [x for x in page.splitlines() if x.startswith(f"| {number} | ")]
    assert "::test_" in row
