"""What a command prints of the library's texts has no advice for Python: arguments are options there."""

import argparse
import ast
import re
from pathlib import Path

import pytest

from spherejax import cli
from spherejax.command_line.advice import in_options
from spherejax.motion.integration.audit import FINDINGS
from spherejax.motion.integration.status import REMEDIES

PACKAGE = Path(cli.__file__).parent
COMMANDS = next(a for a in cli.parser()._actions if isinstance(a, argparse._SubParsersAction)).choices

ADVICE = re.compile(r"\b(?:sj|spherejax|diffrax)\.[A-Za-z]|(?<![-\w.(])[a-z_]+=(?![= ])(?!\")")
"""What is Python: a public name, an argument."""

ROOMS = {
    "files/robots": "run",
    "motion/integration/status.py": "run",
    "motion/integration/audit.py": "run",
    "motion/start": "run",
    "motion/solvers": "run",
    "output/fmu/ports.py": "export",
    "output/fmu/programs.py": "export",
    "output/plot/animation.py": "draw",
    "physics": "run",
    "studies/fit": "fit",
    "studies/sweep": "sweep",
    "studies/sensitivity": "sensitivity",
    "studies/uncertainty": "tolerances",
    "studies/cycles/family.py": "cycle",
    "studies/cycles/shooting.py": "cycle",
    "studies/cycles/study.py": "cycle",
    "studies/subjects": "compare",
}
"""Whose texts a command prints, and one that does."""

OPTION = re.compile(r"--[a-z-]+ (?:\"[^\"]*\"|\S+)")

OF_PYTHON_ALONE = (
    "traced", "jax.", "(static=True)", "functions=", "logarithmic=", "mode=",
    "builder", "orientation(", "sequence", "Body.rod",
)  # fmt: skip
"""Phrases of texts that no command prints: of derivatives, traces, functions of the user's own, builders of scenes."""


def texts(file: Path):
    """All texts of a file but docstrings; what is filled in stands as braces."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
            yield text.replace("={}", "='x'")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not {id(node)} & (inner | alone):
            yield node.value


@pytest.mark.parametrize("room", ROOMS)
def test_texts_of_the_library_have_no_advice_for_python_in_a_command(room):
    place = PACKAGE / room
    files = [place] if place.is_file() else sorted(place.rglob("*.py"))
    assert files
    for text in (text for file in files for text in texts(file) if " " in text and ADVICE.search(text)):
        if not any(phrase in text for phrase in OF_PYTHON_ALONE):
            said = in_options(text, COMMANDS[ROOMS[room]]._option_string_actions)
            assert not ADVICE.search(OPTION.sub("", said)), f"{text}\n-> {said}"


@pytest.mark.parametrize(
    ("command", "python", "option"),
    [
        ("run", "Raise max_steps (solver=spherejax.solvers.Rodas5P())", "Raise --max-steps (--solver rodas5p)"),
        ("run", "leave it out with load_mjcf(..., ignore=('a', 'b'))", "leave it out with --ignore a,b"),
        ("run", 'stops={"turning": {"stiffness": 500.0, "restitution": 0.5}}', "--stops turning=500.0:0.5"),
        ("run", "friction=sj.Threlfall(mu=1.0, v1=1e-2)", '--friction "threlfall mu=1.0 v1=1e-2"'),
        ("run", "conformity=sj.laws.WinklerLiner(...)", 'conformity = { kind = "WinklerLiner", ... }'),
        ("run", "give the joint starts_concentric=False", "give the joint starts_concentric = false"),
        ("run", "leave length= out", "leave length out"),
        ("run", "position.rocker=1 um", "position.rocker=1 um"),
        ("fit", "Let the record grow (horizon=sj.studies.GrowingHorizon())", "Let the record grow (without --whole)"),
        ("sweep", "give a folder, store='sweep.zarr'", "give a folder, --out sweep.zarr"),
        ("sweep", 'record=["final position.rocker"]', '--record "final position.rocker"'),
        ("sweep", "--vary clearance=0.1: no such number", "--vary clearance=0.1: no such number"),
    ],
)
def test_arguments_are_options(command, python, option):
    assert in_options(python, COMMANDS[command]._option_string_actions) == option


def test_remedies_name_options_that_there_are():
    flags = COMMANDS["run"]._option_string_actions
    for text in (*REMEDIES.values(), *FINDINGS.values()):
        assert set(re.findall(r"--[a-z-]+", in_options(text, flags))) <= flags.keys()


def test_an_error_and_a_warning_of_a_command_name_options(tmp_path, capsys):
    assert cli.main(["run", "four-bar", "--t1", "0.1", "--max-steps", "3"]) == 3
    said = capsys.readouterr().err
    assert "Raise --max-steps, loosen --rtol" in said
    assert "--solver rodas5p" in said
