"""Lines of the package by room, the longest function, the most arguments: `python scripts/house.py [REVISION]...`."""

import ast
import subprocess
import sys
from collections import Counter
from typing import NamedTuple


class Function(NamedTuple):
    """What is counted of one."""

    lines: int
    arguments: int
    name: str


def git(*command: str) -> str:
    """What git answers."""
    return subprocess.run(["git", *command], check=True, stdout=subprocess.PIPE, text=True).stdout


def functions(tree: ast.AST, module: str) -> list[Function]:
    """All functions of a module; `self` and `cls` are no arguments."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            count = len([name for name in names if name not in ("self", "cls")])
            found.append(Function(node.end_lineno - node.lineno + 1, count, f"{module}:{node.name}"))
    return found


def main() -> None:
    """Print a line for each room, and the extremes, of each revision."""
    for revision in sys.argv[1:] or ["HEAD"]:
        rooms, longest_file, found = Counter(), (0, ""), []
        for path in git("ls-tree", "-r", "--name-only", revision, "rvm_mpi").splitlines():
            if path.endswith(".py"):
                text = git("show", f"{revision}:{path}")
                lines, parts = len(text.splitlines()), path.split("/")
                rooms[parts[1] if len(parts) > 2 else "."] += lines
                longest_file = max(longest_file, (lines, path))
                found += functions(ast.parse(text), path)
        print(f"{revision}: {rooms.total()} lines; " + ", ".join(f"{room} {n}" for room, n in sorted(rooms.items())))
        print("  longest file: {1}, {0}".format(*longest_file))
        longest, most = max(found), max(found, key=lambda one: one.arguments)
        print(f"  longest function: {longest.name}, {longest.lines}; most arguments: {most.name}, {most.arguments}")


if __name__ == "__main__":
    main()
