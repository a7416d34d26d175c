"""Files and modules that the documents and the comments name are there: a name that has moved is found at once."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("rvm_mpi", "tests", "benchmarks", "postprocess", "scripts", "jobs", "docs")
FILES = [path.relative_to(ROOT).as_posix() for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [ROOT / "Makefile", ROOT / "pyproject.toml"]
SOURCES += sorted(
    path
    for folder in FOLDERS[:-1]
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".c", ".sh", ".toml")
)
#: in a program: `kinetic/drift.py`, or from the root
NAMED = rf"`([\w/]+\.(?:py|sh|md|c))[`:]|\b((?:{'|'.join(FOLDERS)})/[\w./-]*\w\.(?:py|sh|md|c|toml|json))\b"


def is_there(name):
    """A file by its path or the end of it; names in capitals (`jobs/JOB.toml`) stand for others."""
    return Path(name).stem.isupper() or any(one == name or one.endswith(f"/{name}") for one in FILES)


def named(path, pattern):
    return {one for found in re.findall(pattern, path.read_text(encoding="utf-8")) for one in found if one}


@pytest.mark.parametrize("path", PAGES + SOURCES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files_that_are_named_are_there(path):
    assert [name for name in named(path, NAMED) if not is_there(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_and_modules_of_a_page(page):
    text = page.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([\w./-]+[./][\w./-]*)\)", text) if not (page.parent / link).exists()]
    assert links == []
    for name in re.findall(r"\brvm_mpi(?:\.\w+)+", text):
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:  # then something within it
            module, _, what = name.rpartition(".")
            assert hasattr(importlib.import_module(module), what), name
