"""What a user types to see whether it works: the Makefile's targets, and the script that tries them elsewhere."""

import subprocess

import pytest
from conftest import ROOT


def said(*command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("target", ["demo", "test", "long-tests", "fault-tests"])
def test_no_opinion_of_a_linter_stops(target):
    plan = said("make", "--dry-run", target)
    assert plan.returncode == 0, plan.stderr
    assert ("rvm run" if target == "demo" else "pytest") in plan.stdout
    assert "mypy" not in plan.stdout
    assert "ruff" not in plan.stdout


def test_continuous_integration_lints_first_and_then_tests():
    lines = (ROOT / ".ci" / "run").read_text().splitlines()
    steps = ["make lint", "scripts/numba_versions.sh bits", "exec make test"]
    assert lines[1:] == [lines[1], "set -eu", 'cd "$(dirname "$0")/.."', *steps]
    assert "mypy" in said("make", "--dry-run", "lint").stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "which system? debian12, debian13, ubuntu2204 or ubuntu2404"),
        (("debian11",), "which system?"),
        (("debian13", "--mirror"), "--mirror wants a value"),
        (("debian13", "--clean"), "no such option: --clean"),
    ],
)
def test_a_wrong_request_to_elsewhere_is_one_line(arguments, words):
    done = said("scripts/elsewhere.sh", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("elsewhere: ")
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
