"""Fixtures of the fault tests: a job, the undisturbed run of it, and a count of what was tried."""

from collections import Counter

import pytest
from faults import faulty

COUNTS = pytest.StashKey[Counter]()


def pytest_configure(config):
    config.stash[COUNTS] = Counter()


def pytest_terminal_summary(terminalreporter, config):
    """The figures, under the results."""
    for name, count in sorted(config.stash[COUNTS].items()):
        terminalreporter.write_line(f"{name}: {count}")


@pytest.fixture(scope="session")
def tally(request):
    """Counts of what was tried, printed at the end."""
    return request.config.stash[COUNTS]


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Directory of the undisturbed run, on one rank."""
    top = tmp_path_factory.mktemp("whole")
    (top / "job.toml").write_text(faulty.JOB)
    status, lines = faulty.run(
        1, [], top / "job.toml", "--output", top / "run", "--quiet", log=top / "log", bound=faulty.COMPILING
    )
    assert (status, lines) == (0, []), (top / "log").read_text()
    return top / "run"


@pytest.fixture
def place(tmp_path):
    """A folder with the job file in it."""
    (tmp_path / "job.toml").write_text(faulty.JOB)
    return tmp_path
