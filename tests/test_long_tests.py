"""The list of long tests names tests that exist, and leaves others of the same file to the fast ones."""

import ast
from functools import lru_cache

from conftest import ROOT, UNKNOWN, long_tests


@lru_cache
def names_in(file: str) -> frozenset[str]:
    """Names of the tests in a file."""
    tree = ast.parse((ROOT / file).read_text())
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def test_long_tests_exist():
    named = [name.split("[")[0].split("::") for name in long_tests()]
    assert [test for file, test in named if test not in names_in(file)] == []


def test_its_case_exists(request):
    """Of the files that were collected with this one: of all, when all tests are run."""
    assert request.config.stash[UNKNOWN] == []


def test_every_file_has_fast_tests_as_well():
    """The fast tests go through every file: a file of which all is long says so itself, by `pytestmark`."""
    for file in {name.split("::")[0] for name in long_tests()}:
        listed = {name.split("::")[1] for name in long_tests() if name.startswith(f"{file}::")}
        tests = {name for name in names_in(file) if name.startswith("test_")}
        assert tests - listed, file
