"""What users copy stands on public names: notebooks, documentation pages and the README reach no private module."""

import ast
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from documentation import DOCS, README, program
from public import NAMESPACES

import spherejax as sj

ROOT = Path(__file__).parent.parent
MODULES = {
    "spherejax": sj.__all__,
    **{space.__name__: space.__all__ for space in NAMESPACES.values()},
    "spherejax.gallery": sj.gallery.__all__,
    "spherejax.plot": sj.plot.__all__,
    "spherejax.priors": sj.priors.__all__,
    "spherejax.runtime": ["configure", "require_float64"],
}
"""Public modules with their names; the reference in docs/api describes them."""

examples = program("examples")
PAGES = sorted({*examples.pages(), README})
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FENCED = re.compile(r"^```(?:python|py)\b[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


def code_of(path: Path) -> str:
    """All Python of a page or a notebook."""
    if path.suffix == ".ipynb":
        cells = nbformat.read(path, as_version=4).cells
        lines = [line for cell in cells if cell.cell_type == "code" for line in cell.source.splitlines()]
        return "\n".join(line for line in lines if not line.startswith("%"))  # magic commands are no Python
    return "\n\n".join(FENCED.findall(path.read_text()))


def private_names(code: str) -> list[str]:
    """Names of spherejax that a program imports, or reaches by dots, and that are not public."""
    tree, found = ast.parse(code), []
    stands_for = {"spherejax": "spherejax"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.partition(".")[0] == "spherejax":
                    stands_for[alias.asname or "spherejax"] = alias.name if alias.asname else "spherejax"
                    found += [] if alias.name in MODULES else [alias.name]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "spherejax":
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if alias.name not in MODULES.get(node.module or "", ()):
                    found.append(name)
                elif name in MODULES:
                    stands_for[alias.asname or alias.name] = name
    return found + [
        f"{module}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and (module := _module_of(node.value, stands_for)) in MODULES
        if node.attr not in MODULES[module]
    ]


def _module_of(node: ast.expr, stands_for: dict[str, str]) -> str:
    """The module of spherejax that an expression is; empty for other things."""
    if isinstance(node, ast.Name):
        return stands_for.get(node.id, "")
    if isinstance(node, ast.Attribute) and (owner := _module_of(node.value, stands_for)):
        return f"{owner}.{node.attr}"
    return ""


@pytest.mark.parametrize("path", [*PAGES, *NOTEBOOKS], ids=lambda path: str(path.relative_to(ROOT)))
def test_only_public_names_are_used(path):
    code = code_of(path)
    assert "spherejax" in code or path.suffix == ".md"
    assert not private_names(code)


@pytest.mark.parametrize(
    ("code", "private"),
    [
        ("import spherejax as sj\nsj.plot.letter, sj.gallery.four_bar, sj.Dry(1e-4).clearance", []),
        ("from spherejax import plot, Dry\nplot.letter", []),
        ("from spherejax.plot import letter\nimport spherejax.gallery\nspherejax.gallery.hip", []),
        ("from spherejax.output.plot.style import letter", ["spherejax.output.plot.style.letter"]),
        ("from spherejax import physics", ["spherejax.physics"]),
        ("import spherejax.physics.laws as laws", ["spherejax.physics.laws"]),
        ("import spherejax as sj\nsj.studies.fit.Whole()", ["spherejax.studies.fit"]),
        ("from spherejax import plot as p\np.dress", ["spherejax.plot.dress"]),
        ("import spherejax\nspherejax.plot.style", ["spherejax.plot.style"]),
    ],
)
def test_private_names_are_found(code, private):
    assert private_names(code) == private


def test_the_pages_are_read():
    assert README in PAGES
    assert len(PAGES) > 20
    assert all("import spherejax as sj" in code_of(path) for path in (README, DOCS / "getting_started.md"))


@pytest.mark.parametrize("module", [sj.plot, sj.priors], ids=lambda module: module.__name__)
def test_public_modules_say_what_they_hold(module):
    assert module.__doc__
    public = {name: getattr(module, name) for name in module.__all__}
    assert not [name for name, thing in public.items() if callable(thing) and not inspect.getdoc(thing)]
    if module is sj.plot:
        assert all(f"`{name}`" in module.__doc__ for name in public if name not in ("Curves", "Shade"))


def test_plot_is_offered_and_imported_when_it_is_first_used():
    code = (
        "import sys, spherejax as sj; print('plot' in dir(sj), 'matplotlib' in sys.modules);"
        "sj.plot.new_figure; print('matplotlib' in sys.modules, 'matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == ["True", "False", "True", "False"]
    with pytest.raises(AttributeError, match="No spherejax attribute no_such_name"):
        sj.no_such_name  # noqa: B018


def test_what_type_checkers_read_is_what_there_is():
    tree = ast.parse((Path(sj.__file__).parent / "__init__.pyi").read_text())
    listed = next(ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign))
    assert sorted(sj.__all__) == sorted(listed)
    assert all(getattr(sj, name) is not None for name in listed)


@pytest.mark.parametrize("name", [name for name in NAMESPACES if name != "compiler"])
def test_what_type_checkers_read_of_a_namespace_is_what_there_is(name):
    space = NAMESPACES[name]
    tree = ast.parse(Path(space.__file__).with_suffix(".pyi").read_text())
    listed = next(ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign))
    assert sorted(space.__all__) == sorted(listed)


# Pint looks for dask, and of some versions dask takes xarray along: no choice of ours.
NO_DASK = "import sys; sys.argv[0] = 'spherejax'; sys.modules['dask'] = None; from spherejax.cli import main\n"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--help"], 0),
        (["run", "--help"], 0),
        (["run", "four-bar", "--clearance", "0,1 mm"], 2),
        (["run", "four-bar", "--joint", "dri"], 2),
        (["run", "fourbar"], 2),
        (["sweep", "four-bar", "--out", "x.nc"], 2),
    ],
)
def test_help_and_wrong_arguments_do_not_wait_for_jax(words, code):
    program = (
        NO_DASK
        + f"print(main({words!r}), [name for name in ('jax', 'xarray', 'matplotlib', 'rich') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines()[-1] == f"{code} []"


GAP = "joints.coupler_rocker.model.clearence"
FOUR_BAR = "four-bar --joint dry"
MISSPELT = [
    f"run {FOUR_BAR} --set {GAP}=1e-4",
    f"run {FOUR_BAR} --peak reaction.couplerrocker",
    f"draw {FOUR_BAR} --set {GAP}=1e-4 --out x.png",
    f"sweep {FOUR_BAR} --vary {GAP}=1e-4,2e-4 --out x.nc",
    f"sweep {FOUR_BAR} --vary clearance=1e-4:2e-4 --vary rocker.mas=1:2 --draws 4 --out x.nc",
    f"sweep {FOUR_BAR} --vary mu=0.1,0.2 --joint friction --record position.rockr --out x.nc",
    f"sensitivity {FOUR_BAR} --by {GAP} --of position.rocker.z",
    f"sensitivity {FOUR_BAR} --by clearance --of position.rockr.z",
    f"modes {FOUR_BAR} --by {GAP}",
    f"tolerances {FOUR_BAR} --tolerance {GAP}=+-10% --of position.rocker.z",
    f"tolerances {FOUR_BAR} --tolerance clearance=+-10% --of position.rockr.z",
    f"fit {FOUR_BAR} --measured no.csv --start {GAP}=1e-4",
    f"export {FOUR_BAR} --fmu x.fmu --output position.rockr",
    f"accuracy {FOUR_BAR} --set {GAP}=1e-4",
    f"cycle {FOUR_BAR} --set {GAP}=1e-4 --period 0.1",
    f"write {FOUR_BAR} --set {GAP}=1e-4 --out x.toml",
    "rig double-wishbone --set joints.lowerarm.axis.x=1",
]


def test_misspelt_names_of_the_scene_wait_for_jax_alone():
    """What integrates, draws and tabulates takes seconds to import; what is told first is what is not there."""
    program = (
        NO_DASK + "for words in sys.stdin.read().splitlines():\n"
        "    code = main(words.split())\n"
        "    print(code, [m for m in ('diffrax', 'xarray', 'matplotlib', 'rich') if m in sys.modules], words)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        input="\n".join(MISSPELT),
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.splitlines() == [f"2 [] {words}" for words in MISSPELT]
    told = done.stderr.splitlines()
    assert len(told) == len(MISSPELT)
    assert all("did you mean" in line for line in told), done.stderr


@pytest.mark.parametrize("start", [["-m", "spherejax"], ["-c", "from spherejax.cli import main; main(['list'])"]])
def test_the_command_sets_itself_up_when_it_has_read_its_arguments(start, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import atexit, os, sys\n"
        "@atexit.register\n"
        "def told():\n"
        "    print(sys.modules['jax'].config.read('jax_enable_x64'), 'small_while_loop' in os.environ['XLA_FLAGS'])\n"
    )
    words = [sys.executable, *start, *(["list"] if start[0] == "-m" else [])]
    clean = {key: value for key, value in os.environ.items() if key not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    environment = {**clean, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120, env=environment)
    assert done.stdout.splitlines()[-1] == "True True"
