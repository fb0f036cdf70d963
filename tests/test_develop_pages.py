"""What rots on the pages for developers, and beside the README: files, names, versions, floors. Nothing of JAX runs."""

import ast
import re
import subprocess
import tomllib
from functools import cache
from pathlib import Path

import pytest
import test_architecture
import yaml
from documentation import DOCS, program

ROOT = DOCS.parent
PAGES = sorted((DOCS / "develop").glob("*.md"))
WITH_PATHS = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / ".github" / "pull_request_template.md"]
SUFFIXES = "py|md|toml|cff|csv|png|yml|yaml"
PATH = re.compile(rf"`([\w./*-]+/[\w./*-]*|[\w*-]+\.(?:{SUFFIXES}))?(?:::(\w+))?`")
floors = program("extensions/floors")


def files_of(path: str) -> list[Path]:
    """What a path on a page names: in the repository, or below the package."""
    return sorted({*ROOT.glob(path), *(ROOT / "spherejax").glob(path)})


@cache
def names_of(path: Path) -> set[str]:
    """Names that a file defines, those within classes too."""
    defined = ast.FunctionDef | ast.ClassDef
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = {node.name for node in nodes if isinstance(node, defined)}
    targets = [t for n in nodes if isinstance(n, ast.Assign) for t in n.targets]
    targets += [n.target for n in nodes if isinstance(n, ast.AnnAssign)]
    return names | {target.id for target in targets if isinstance(target, ast.Name)}


def wrong_in(text: str) -> list[str]:
    """Paths and names in backticks that are not there; a name without a path is in the file named last."""
    wrong, last = [], None
    for path, name in PATH.findall(text):
        if path:
            found = files_of(path.rstrip("/"))
            last = found[0] if found else None
            wrong += [] if found else [path]
        if name and last is not None and (last.suffix != ".py" or name not in names_of(last)):
            wrong.append(f"{path}::{name}")
    return wrong


@pytest.mark.parametrize("page", WITH_PATHS, ids=lambda page: page.name)
def test_files_and_names_on_a_page_exist(page):
    assert not wrong_in(page.read_text())


def test_a_wrong_path_or_name_is_seen():
    right = "`motion/runs/simulate.py::simulate`, `::simulate`, `tests/test_laws_*.py`, `physics/laws/`, `mu`, `sj.fit`"
    assert not wrong_in(right)
    assert wrong_in("`motion/simulates.py`") == ["motion/simulates.py"]
    assert wrong_in("`motion/runs/simulate.py::simulates`, `::no`") == ["motion/runs/simulate.py::simulates", "::no"]
    assert wrong_in("`no_such_folder/`, `NOTHING.md`") == ["no_such_folder/", "NOTHING.md"]


# How things are added -------------------------------------------------------------------------------------------------

ADDING = (DOCS / "develop" / "adding.md").read_text()
SECTIONS = re.split(r"^## ", ADDING, flags=re.MULTILINE)[1:]
ROW = re.compile(r"^\| `([^`]+)` \|", re.MULTILINE)


def followed(section: str) -> str:
    found = re.search(r"\bFollowed\b[^:]*: `(\w+)`", section)
    assert found, f"{section.splitlines()[0]}: which one is followed?"
    return found[1]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.splitlines()[0])
def test_what_is_followed_is_named_in_each_file(section):
    word, files = followed(section).lower(), ROW.findall(section)
    assert len(files) >= 2
    for path in files:
        (file,) = files_of(path)
        text = file.name if file.suffix == ".png" else file.read_text()
        assert word in text.lower(), f"{path} does not name {word}"


COUNTED = {
    "friction law": "A friction law",
    "normal law": "A normal law",
    "film": "A film",
    "film boundary": "A film boundary",
    "pressure": "A pressure",
    "elastomer": "An elastomer",
    "joint": "A joint",
    "driver": "A driver",
    "force": "A force",
    "function": "A function of time or length",
    "solver": "A solver",
    "scene of the gallery": "A scene of the gallery",
    "primitive of JAX": "A primitive of JAX",
    "command": "A command",
}


@pytest.mark.parametrize("kind", COUNTED)
def test_the_counts_are_those_of_the_lists(kind):
    said = re.search(rf"^\| {kind} \| (?:\d or )?(\d+) \| (\d+) \| (\d+) \|$", ADDING, re.MULTILINE)
    assert said
    (section,) = [one for one in SECTIONS if one.splitlines()[0] == COUNTED[kind]]
    tops = [files_of(path)[0].relative_to(ROOT).parts[0] for path in ROW.findall(section)]
    counts = [tops.count("spherejax"), tops.count("tests"), tops.count("docs") + tops.count("README.md")]
    assert list(map(int, said.groups())) == counts
    assert sum(counts) == len(tops)


def test_every_kind_is_counted():
    assert sorted(COUNTED.values()) == sorted(section.splitlines()[0] for section in SECTIONS)


# The floors -----------------------------------------------------------------------------------------------------------


def test_the_picture_has_the_floors_that_the_imports_are_held_to():
    assert [floor for floor in floors.ORDER if floor != "runtime"] == test_architecture.ORDER
    drawn = floors.house()
    assert drawn.floors == tuple(reversed(floors.ORDER))
    assert all(drawn.floors.index(above) < drawn.floors.index(below) for above, below in drawn.imports)
    assert sum(n_files for n_files, _ in drawn.sizes.values()) == len(test_architecture.FILES)
    assert floors.svg(drawn).count("<rect") == len(drawn.floors)


def test_an_import_that_goes_up_and_a_folder_without_a_floor_fail_the_build(tmp_path):
    from sphinx.errors import SphinxError

    package = tmp_path / "pack"
    for name in ("low", "high"):
        (package / name).mkdir(parents=True)
    (package / "runtime.py").write_text("")
    (package / "low" / "one.py").write_text("from pack import runtime\n")
    (package / "high" / "two.py").write_text("from pack.low import one\nfrom pack.low.one import something\n")
    drawn = floors.house(package, ("runtime", "low", "high"))
    assert drawn.imports == {("high", "low"): 2, ("low", "runtime"): 1}
    assert drawn.sizes == {"high": (1, 2), "low": (1, 1), "runtime": (1, 0)}
    with pytest.raises(SphinxError, match="no floor"):
        floors.house(package, ("runtime", "low"))
    with pytest.raises(SphinxError, match="upwards"):
        floors.house(package, ("runtime", "high", "low"))


# Beside the README ----------------------------------------------------------------------------------------------------

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_citation_has_the_version_of_the_package():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == PROJECT["project"]["version"]
    assert citation["license"] == PROJECT["project"]["license"]
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "type"} <= set(citation)
    assert citation["references"][0]["doi"] == "10.1007/s11044-022-09843-y"


def test_the_changelog_has_what_is_not_released_on_top():
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "[Unreleased]"


def test_lowest_versions_are_declared_and_forms_can_be_read():
    assert all(
        re.fullmatch(r"[\w.-]+>=[\d.]+(; sys_platform == 'linux')?", one) for one in PROJECT["project"]["dependencies"]
    )
    for path in sorted((ROOT / ".github").rglob("*.yml")):
        assert yaml.safe_load(path.read_text()), path
    for path in sorted((ROOT / ".ci").iterdir()):
        subprocess.run(["bash", "-n", str(path)], check=True)


# The life of a run ---------------------------------------------------------------------------------------------------

run_files = program("extensions/run_files")
LIFE = (DOCS / "develop" / "life_of_a_run.md").read_text()


def test_a_run_reads_in_fifteen_files():
    assert len(run_files.files_on(LIFE)) <= 15
    assert len(LIFE.splitlines()) <= 70


def test_files_of_a_run_are_drawn_from_above_to_below():
    """The entry first; each imports only files below it, and the numbers are those of its import statements."""
    drawn = run_files.drawn_from(LIFE)
    assert drawn.floors[0] == "motion/runs/simulate.py"
    assert set(drawn.floors) == set(run_files.files_on(LIFE))
    for one, other in drawn.imports:
        assert drawn.floors.index(one) < drawn.floors.index(other)
    engine, stages = "motion/integration/lanes/engine.py", "motion/integration/lanes/stages.py"
    assert drawn.imports[engine, stages] == 1
    assert f"{engine} imports" in floors.words(drawn)
    assert floors.svg(drawn, run_files.NAMES, run_files.SHAFT).count("<circle") == len(drawn.floors) - 1 - sum(
        not any(one == name for one, _ in drawn.imports) for name in drawn.floors[:-1]
    )
