"""The house: folders import downwards only, files within a folder too, one importer of matplotlib."""

import ast
import os
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import spherejax
import spherejax.compiler
import spherejax.program_cache
from spherejax.program_cache import package_state

PACKAGE = Path(spherejax.__file__).parent
ORDER = [
    "compiler", "program_cache", "foundations", "physics", "model", "gallery", "motion", "files", "output", "studies",
    "command_line", "top",
]  # fmt: skip
ALONE = ["compiler", "program_cache"]
"""Buildings that import nothing else of the package, so that they could be published alone."""
ROOMS = ["settings", "equations", "start", "solvers", "integration", "derivatives", "results", "runs"]
"""Of `motion`, in the order of a run."""
FILES = sorted(PACKAGE.rglob("*.py"))


def folder_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else "top"


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


def _executed(tree: ast.AST):
    """All nodes but those under `if TYPE_CHECKING:`, which only type checkers see."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        yield node
        yield from _executed(node)


@cache
def imported(path: Path, *, for_types: bool = True) -> set[str]:
    """Full names that a file imports, anywhere in it, within functions too, and for type checkers if asked.

    `from` imports are resolved to the module where there is one.
    """
    names, tree = set(), ast.parse(path.read_text())
    for node in ast.walk(tree) if for_types else _executed(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                names.add(full if full in MODULES else node.module)
    return names


def test_the_folders_are_the_known_ones():
    assert {folder_of(path) for path in FILES} <= set(ORDER)


def goes_down(path: Path, name: str) -> bool:
    """Whether a file of a floor may import a module of the package."""
    own = folder_of(path)
    if own == "command_line" and name == "spherejax":
        return True  # the command line is a user of the public names
    if name == "spherejax.runtime":
        return own not in ALONE  # it sets up the process, and stands between these two and all else
    return name in MODULES and ORDER.index(folder_of(MODULES[name])) <= ORDER.index(own)


def test_imports_go_down():
    of_ours = [(path, name) for path in FILES for name in imported(path) if name.split(".")[0] == "spherejax"]
    assert [f"{path}: {name}" for path, name in of_ours if not goes_down(path, name)] == []


@pytest.mark.parametrize("building", ALONE)
def test_a_building_that_stands_alone_imports_nothing_else_of_the_package(building):
    own = f"spherejax.{building}"
    of_ours = [
        (path, name)
        for path in FILES
        for name in imported(path)
        if folder_of(path) == building and name.split(".")[0] == "spherejax"
    ]
    assert [f"{path}: {name}" for path, name in of_ours if name != own and not name.startswith(f"{own}.")] == []


PUBLIC_MODULES = {"spherejax.compiler"} | {
    f"spherejax.compiler.{name}" for name in ("hooks", "linear_algebra", "runge_kutta")
}
"""The doors of the compiler: its public names, and those of them that are modules."""


def users_of_the_compiler() -> dict[str, set[str]]:
    """What each file outside the compiler imports of it, the stubs of the public names too."""
    inside = {path: {n for n in imported(path) if n.startswith("spherejax.compiler")} for path in FILES}
    used = {module_of(path): names for path, names in inside.items() if names and folder_of(path) != "compiler"}
    for stub in PACKAGE.glob("*.pyi"):
        named = re.findall(r"^from \.(compiler[\w.]*) import", stub.read_text(), re.MULTILINE)
        used |= {str(stub): {f"spherejax.{name}" for name in named}} if named else {}
    return used


def test_the_compiler_is_entered_by_public_names_and_from_few_files():
    users = users_of_the_compiler()
    assert {module: names - PUBLIC_MODULES for module, names in users.items() if names - PUBLIC_MODULES} == {}
    assert 0 < len(users) <= 10
    assert len(spherejax.compiler.__all__) <= 8
    public = {f"spherejax.compiler.{name}" for name in spherejax.compiler.__all__}
    assert public >= PUBLIC_MODULES - {"spherejax.compiler"}
    assert all(getattr(spherejax.compiler, name) is not None for name in spherejax.compiler.__all__)


def test_the_compiler_brings_no_jax_before_it_is_used():
    """`import spherejax` attaches the disk cache to it, and must not take the time that JAX takes."""
    program = "import sys, spherejax.compiler.hooks; assert 'jax' not in sys.modules"
    environment = {**os.environ, "SPHEREJAX_CONFIGURE": "0"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment, capture_output=True)


def test_the_program_cache_is_used_by_its_public_names():
    """Its decorators stand wherever something is compiled or remembered; all else of it is known to fifteen files."""
    public = set(spherejax.program_cache.__all__)
    assert len(public) <= 10
    deep, n_further = [], 0
    for path in FILES:
        if folder_of(path) == "program_cache":
            continue
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        of_cache = [node for node in nodes if (node.module or "").startswith("spherejax.program_cache")]
        names = [[*str(node.module).split("."), alias.name][2] for node in of_cache for alias in node.names]
        deep += [f"{path}: {name}" for name in names if name not in public]
        n_further += any(name not in ("cached_jit", "memoized", "gc_paused") for name in names)
    assert deep == []
    assert n_further <= 15


def between_rooms(folder: str, rooms: list[str]) -> list[str]:
    """Imports of a room of a folder by one before it."""
    found = []
    top = PACKAGE / folder / "__init__.py"
    for path in (path for path in FILES if folder_of(path) == folder and path != top):
        own = Path(path.relative_to(PACKAGE / folder).parts[0]).stem
        assert own in rooms, f"every file of {folder}/ stands in a room: {path}"
        others = [name for name in imported(path) if name.startswith(f"spherejax.{folder}.")]
        found += [f"{path}: {name}" for name in others if rooms.index(name.split(".")[2]) > rooms.index(own)]
    return found


def test_rooms_of_motion_follow_the_run():
    assert between_rooms("motion", ROOMS) == []


ROOMS_OF_FILES = ["paths", "fields", "scenes", "robots"]
"""Of `files`: how one is written, an argument, a scene; robot descriptions beside it."""


def test_rooms_of_files_go_from_numbers_to_scenes():
    assert between_rooms("files", ROOMS_OF_FILES) == []


def test_most_of_the_foundations_stands_in_rooms():
    """What is read together (numbers with units) stands in a room; the rest is short."""
    loose = [path for path in FILES if path.parent == PACKAGE / "foundations"]
    assert len(loose) <= 13
    assert sum(len(path.read_text().splitlines()) for path in loose) <= 1200


def test_cached_programs_are_told_apart_by_all_files_of_the_package():
    assert {path.resolve() for path in FILES} == set(package_state.sources())


def test_runtime_imports_what_it_joins_and_nothing_else_of_the_package():
    """Every floor but those two may stand on it, and it must not bring JAX to commands that only print help."""
    names = {name for name in imported(PACKAGE / "runtime.py") if name.startswith("spherejax")}
    assert names == {"spherejax.compiler.hooks", "spherejax.program_cache.folders"}
    program = "import sys, spherejax.runtime; assert 'jax' not in sys.modules"
    environment = {**os.environ, "SPHEREJAX_CONFIGURE": "0"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment, capture_output=True)


def late_imports(path: Path) -> set[str]:
    """What is imported by functions, when they are called."""
    functions = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]
    nodes = [node for function in functions for node in ast.walk(function) if isinstance(node, ast.ImportFrom)]
    return {str(node.module) for node in nodes if str(node.module).startswith("spherejax")}


def test_what_is_imported_late_is_what_takes_long():
    """Pictures, files and commands are not loaded with the package; all else stands at the head of a file."""
    late = ("spherejax.output", "spherejax.files.scenes.text")
    for path in FILES:
        if folder_of(path) not in ("command_line", "top"):
            assert all(name.startswith(late) for name in late_imports(path)), path


def test_one_file_goes_up_by_name():
    """`run.report`: a method of a result whose page is made above it. Nothing else may hide an import in a text."""
    hidden = {path for path in FILES if "import_module(" in path.read_text() and folder_of(path) != "top"}
    hidden = {path for path in hidden if 'import_module("spherejax' in path.read_text()}
    assert hidden == {PACKAGE / "motion" / "results" / "reported.py"}


def test_imports_have_no_cycle():
    graph = {
        module: {name for name in imported(path) if name in MODULES and name != module}
        for module, path in MODULES.items()
    }
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"files import each other: {' -> '.join(error.args[1])}")


def test_matplotlib_only_in_plot():
    users = {
        path for path in FILES if any(name.split(".")[0] == "matplotlib" for name in imported(path, for_types=False))
    }
    assert {path.relative_to(PACKAGE).parts[:2] for path in users} <= {("output", "plot")}


def test_no_name_stands_for_two_classes():
    """A reader who meets `Trial` or `Limit` looks for one; fifty names stood for two to four."""
    owners: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                owners.setdefault(node.name, []).append(module_of(path))
    assert len(owners) > 300
    assert {name: modules for name, modules in owners.items() if len(modules) > 1} == {}


def test_checks_can_fail(tmp_path):
    bad = tmp_path / "bad.py"
    late = "def late():\n    from spherejax.physics.bodies import Body\n"
    bad.write_text("from spherejax.motion.runs import simulate\nimport matplotlib.pyplot as plt\n" + late)
    assert {"spherejax.motion.runs.simulate", "matplotlib.pyplot", "spherejax.physics.bodies"} <= imported(bad)
    assert late_imports(bad) == {"spherejax.physics.bodies"}
    assert not goes_down(PACKAGE / "physics" / "bad.py", "spherejax.motion.runs.simulate")
    assert not goes_down(PACKAGE / "studies" / "bad.py", "spherejax.motion.nothing")
    assert between_rooms("motion", ROOMS[::-1])


TOP_LEVEL = {"pyproject.toml", "spherejax", "tests", "notebooks", "benchmarks", "README.md", "docs"} | {
    "LICENSE", "CHANGELOG.md", "CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md", "SUPPORT.md",
}  # fmt: skip


def test_nothing_stands_at_the_top_by_accident():
    """Folders of compiled programs were committed once, which a run had made where it stood."""
    repository = Path(__file__).parent.parent
    listing = subprocess.run(["git", "ls-files"], cwd=repository, capture_output=True, text=True, check=False)
    if listing.returncode:
        pytest.skip("not a clone")
    names = {line.split("/")[0] for line in listing.stdout.splitlines()}
    assert {name for name in names if not name.startswith(".")} <= TOP_LEVEL
