"""The manners that a program can check: which way imports go, how long files are, how many arguments, whose interfaces.

What breaks them today is listed by name. A list must be exactly what is found: it shrinks with what is mended, and
nothing new gets in unseen.
"""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "rvm_mpi"
LONGEST_FILE = 430
MOST_ARGUMENTS = 8

#: from the lowest to the highest: a room imports from itself and from those before it. "" is the package itself
ROOMS = [
    "", "cache", "units", "terminal", "kinetic_theory", "job", "agree", "compiling", "exact_sum", "measure",
    "diagnostics", "grid", "output", "results", "states", "kinetic", "collisions", "time_limits", "fluid", "step",
    "reference", "advice", "simulation", "run", "commands", "__main__",
]  # fmt: skip

#: importer and imported
UPWARD: set[tuple[str, str]] = {("collisions.penalised", "time_limits")}
CIRCLES: set[tuple[str, ...]] = set()
LONG: set[str] = set()
MANY_ARGUMENTS: set[str] = set()


def modules():
    """Every module by its name without "rvm_mpi.", the package itself as ""."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


def statements(node):
    """Everything below a node but what is there for type checkers alone."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and getattr(child.test, "id", "") == "TYPE_CHECKING":
            continue
        yield child
        yield from statements(child)


def imported(tree):
    """Full names of what a module imports, also within functions: modules, and names from modules."""
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports name the module in full"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def module_of(name):
    """The module of this package that a full name belongs to, None for others'."""
    parts = name.split(".")
    if parts[0] != "rvm_mpi":
        return None
    for n in range(len(parts), 0, -1):
        if ".".join(parts[1:n]) in MODULES:
            return ".".join(parts[1:n])
    return ""


IMPORTS = {name: {module_of(one) for one in imported(tree)} - {None, name} for name, tree in TREES.items()}


def reached(name):
    """All modules that importing one imports, sooner or later."""
    found, todo = set(), [name]
    while todo:
        new = IMPORTS[todo.pop()] - found
        found |= new
        todo += new
    return found


def test_every_room_is_in_the_list():
    assert {name.split(".")[0] for name in MODULES} <= set(ROOMS)


def test_no_circle_among_modules():
    reach = {name: reached(name) for name in MODULES}
    circles = {tuple(sorted(other for other in reach[name] if name in reach[other])) for name in MODULES}
    assert circles - {()} == CIRCLES


def test_no_room_imports_a_higher_one():
    height = {room: k for k, room in enumerate(ROOMS)}
    found = {
        (name, other)
        for name, others in IMPORTS.items()
        for other in others
        if height[other.split(".")[0]] > height[name.split(".")[0]]
    }
    assert found == UPWARD


def test_no_file_is_too_long_to_read():
    lengths = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in MODULES.items()}
    assert {name for name, length in lengths.items() if length > LONGEST_FILE} == LONG


def test_no_function_takes_too_many_arguments():
    found = set()
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                arguments = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([one for one in arguments if one not in ("self", "cls")]) > MOST_ARGUMENTS:
                    found.add(f"{name}.{node.name}")
    assert found == MANY_ARGUMENTS


def test_nothing_internal_of_the_compiler_is_used():
    found = set()
    for name, tree in TREES.items():
        mine = {}  # what names of this module stand for
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                mine.update({a.asname or a.name.split(".")[0]: a.name if a.asname else a.name.split(".")[0]
                             for a in node.names})  # fmt: skip
            elif isinstance(node, ast.ImportFrom):
                mine.update({alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names})
        used = set(imported(tree)) | {whole(node, mine) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        for one in used:
            owner, *parts = one.split(".")
            if owner in ("numba", "llvmlite") and any(p == "core" or (p[0] == "_" and p[:2] != "__") for p in parts):
                found.add((name, one))
    assert found == set()


def whole(node, mine):
    """The full name of an attribute of something imported: `nb.core.types` for `import numba as nb`."""
    parts = []
    while isinstance(node, ast.Attribute):
        parts.insert(0, node.attr)
        node = node.value
    return ".".join([mine.get(node.id, "?"), *parts]) if isinstance(node, ast.Name) else "?"
