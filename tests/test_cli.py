"""The command line as a user meets it: exit codes, messages, files."""

import argparse
import csv
import gc
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import diffrax
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax import cli
from spherejax.command_line import catalog
from spherejax.command_line.catalog import FRICTION_LAWS, NORMAL_LAWS, SOLVERS
from spherejax.command_line.models import model_from
from spherejax.command_line.sweep import asked_of
from spherejax.output.plot.curves import curves_of
from spherejax.studies.compare import compare_models
from spherejax.studies.subject import Comparison, ModelRow
from spherejax.studies.subjects.four_bar import FOUR_BAR

QUICK = ["--t1", "0.01", "--samples", "5"]


def parsed(*words):
    return cli.parser().parse_args(["run", "four-bar", *words])


COMMANDS = (
    "run",
    "draw",
    "compare",
    "effects",
    "accuracy",
    "sweep",
    "fit",
    "identify",
    "sensitivity",
    "tolerances",
    "modes",
    "rig",
    "cycle",
    "write",
    "export",
    "list",
)


COMPLETED = {
    "sw": "sweep",
    "run four-b": "four-bar",
    "run pyproj": "pyproject.toml",
    "run four-bar --joint l": "lubricated",
    "run four-bar --out README": "README.md",
    "draw four-bar --magn": "--magnify",
}


def test_shell_completes_commands_options_scenes_and_files(tmp_path, capsys):
    assert cli.main(["--print-completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    lines = [
        f"source {script}",
        "function=$(complete -p spherejax | sed 's/.*-F \\([^ ]*\\) .*/\\1/')",
        'of() { COMP_WORDS=(spherejax "$@"); COMP_CWORD=$#; COMPREPLY=()',
        '$function spherejax "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"; echo "${COMPREPLY[*]}"; }',
        *(f"of {words}" for words in COMPLETED),
    ]
    folder = Path(__file__).parent.parent
    shell = subprocess.run(["bash", "-c", "\n".join(lines)], capture_output=True, text=True, cwd=folder)
    assert shell.stderr == ""
    assert shell.stdout.splitlines() == list(COMPLETED.values())
    assert cli.main(["--print-completion", "zsh"]) == 0
    script = capsys.readouterr().out
    assert script.startswith("#compdef spherejax")
    assert "scenes:scene:(" in script


@pytest.mark.parametrize("words", [["list", "--kinds"], ["--help"]])
def test_a_reader_that_goes_early_gets_no_traceback(words):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "spherejax", *words]
    ended = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert ended.stderr == ""
    # argparse passes over the error itself where Python's output is not buffered.
    assert ended.returncode == 141 or words == ["--help"]


def test_completion_without_its_package_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert cli.main(["--print-completion", "bash"]) == 2
    assert "pip install 'spherejax[completion]'" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), *((name,) for name in COMMANDS)])
def test_help_says_what_the_command_does_and_gives_an_example(words, capsys):
    assert cli.main([*words, "--help"]) == 0
    out = capsys.readouterr().out
    assert "example" in out
    assert f"spherejax {words[0] if words else 'run'}" in out
    assert max(map(len, out.splitlines())) <= 110


def test_the_package_is_a_command_too():
    done = subprocess.run([sys.executable, "-m", "spherejax", "run", "nothing"], capture_output=True, text=True)
    assert done.returncode == cli.BAD_REQUEST
    assert "there is no scene 'nothing'" in done.stderr


def test_help_of_run_names_defaults_with_units(capsys):
    cli.main(["run", "--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert "radial clearance [m] (default: 1e-4)" in out
    assert "dynamic viscosity [Pa s] (default: 0.4)" in out
    assert "length of the motion [s] (default: 2, or as published)" in out


def test_run_writes_what_simulate_gives(tmp_path, capsys):
    path = tmp_path / "run.nc"
    assert cli.main(["run", "four-bar", "--joint", "dry", *QUICK, "--rtol", "1e-9", "--out", str(path)]) == 0
    expected = sj.simulate(sj.gallery.four_bar(sj.Dry(1e-4)), np.linspace(0.0, 0.01, 5), rtol=1e-9)
    with xarray.open_dataset(path) as ds:
        np.testing.assert_array_equal(ds.position.sel(body="rocker"), expected.position("rocker"))
        assert ds.attrs["status"] == "succeeded"
    out = capsys.readouterr().out
    assert str(path) in out
    assert "contact onsets of coupler_rocker" in out


def test_numbers_may_have_units():
    plain, measured = (
        parsed("--joint", "dry", "--clearance", c, "--t1", t) for c, t in (("1e-4", "0.2"), ("0.1 mm", "200ms"))
    )
    assert (measured.clearance, measured.t1) == pytest.approx((plain.clearance, plain.t1), rel=1e-15)


def test_run_tells_contacts_and_peaks(tmp_path, capsys):
    path = tmp_path / "impacts.csv"
    command = ["run", "four-bar", "--joint", "dry", "--t1", "0.02", "--samples", "3", "--impacts", str(path)]
    more = ("--peak", "reaction.coupler_rocker [kN]", "--spectrum", f"reaction.coupler_rocker={tmp_path / 's.png'}")
    more += ("--spectrum", f"reaction.coupler_rocker.z={tmp_path / 's.csv'}")
    assert cli.main([*command, "--peak", "reaction.coupler_rocker", *more]) == 0
    rows = list(csv.DictReader(path.read_text().splitlines()))
    said = capsys.readouterr().out
    assert f"{len(rows)} contacts" in said
    assert [row["contact"] for row in rows] == [str(i) for i in range(len(rows))]
    largest = max(float(row["peak_force [N]"]) for row in rows)
    assert largest > 50
    assert f"{largest:.5g}"[:4] in said.split("largest reaction.coupler_rocker [N]")[1]
    assert f"{largest / 1e3:.5g}"[:4] in said.split("largest reaction.coupler_rocker [kN]")[1]
    assert cli.main([*command, "--overwrite", "--peak", "reaction.coupler_rocker [mm]"]) == 2
    assert "'mm' is a length [m], but a force [N] is expected" in capsys.readouterr().err
    lines = list(csv.DictReader((tmp_path / "s.csv").read_text().splitlines()))
    assert float(lines[0]["frequency [Hz]"]) == pytest.approx(1 / 0.02)
    assert max(float(line["amplitude [N]"]) for line in lines) > 1.0
    assert (tmp_path / "s.png").stat().st_size > 10_000
    assert cli.main([*command, "--overwrite", "--spectrum", "reaction.coupler_rockr.z=x.csv"]) == 2
    assert "did you mean 'reaction.coupler_rocker'" in capsys.readouterr().err
    assert cli.main([*command, "--overwrite", "--spectrum", "reaction.coupler_rocker"]) == 2
    assert "write QUANTITY=FILE" in capsys.readouterr().err
    assert float(rows[0]["release [s]"]) > float(rows[0]["onset [s]"]) > 0


def test_run_refuses_to_replace_a_file_before_it_simulates(tmp_path, capsys, monkeypatch):
    path = tmp_path / "run.nc"
    path.write_text("precious")
    monkeypatch.setattr(sj, "simulate", lambda *a, **k: pytest.fail("simulated in vain"))
    assert cli.main(["run", "four-bar", "--out", str(path)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert path.read_text() == "precious"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--joint", "dry", "--clearance=-1e-4"), "clearance = -0.0001 must be positive"),
        (("--joint", "dry", "--restitution", "1.5"), "restitution = 1.5 must lie in (0, 1]"),
        (("--clearance", "1e-4"), "--clearance means nothing with --joint ideal"),
        (("--joint", "dry", "--viscosity", "1"), "--viscosity means nothing with --joint dry"),
        (("--joint", "dry", "--mu", "0.1"), "--mu means nothing without friction"),
        (
            ("--joint", "friction", "--mu-static", "0.2"),
            "--mu-static means nothing with --friction threlfall",
        ),
        (
            ("--joint", "dry", "--normal", "hertz", "--restitution", "0.9"),
            "means nothing with --normal hertz",
        ),
        (("--t1", "-1"), "--t1 = -1 must be a positive time"),
        (("--dt", "5"), "--dt = 5 must be positive and not above --t1"),
        (("--samples", "1"), "--samples = 1 must be at least 2"),
        (("--samples", "1000000000000"), "1e+12 samples of every quantity do not fit in memory; ask for at most"),
        (("--dt", "1e-12"), "samples of every quantity do not fit in memory"),
        (("--rtol", "1e-17"), "float64 does not carry"),
        (("--impacts", "impacts.csv"), "--impacts: the studied joint, 'coupler_rocker', has no clearance"),
        (("--peak", "reaction.coupler_roker"), "write 'reaction.NAME' with one of"),
        (("--out", "run.xlsx"), "'.xlsx' names no format"),
    ],
)
def test_a_bad_request_is_one_readable_line(words, message, capsys):
    assert cli.main(["run", "four-bar", *words]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert err.startswith("spherejax: ")


@pytest.mark.parametrize(
    "words", [["fly"], ["run", "six-bar"], ["run", "four-bar", "--joint", "gum"], ["run", "four-bar", "--x"]]
)
def test_an_unknown_word_exits_with_2(words, capsys):
    assert cli.main(words) == 2
    assert "usage: spherejax" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--clearance", "0,1"], "argument --clearance: '0,1' is no number; write 0.1"),
        (["--clearance", "1_0"], "argument --clearance: '1_0' is no number; write 10"),
        (["--clearance", "nan"], "argument --clearance: 'nan' is no number"),
        (["--clearance", "0.1kg"], "argument --clearance: '0.1kg' is a mass [kg], but a length [m] is expected"),
        (
            ["--clearance", "0,1 mm"],
            """'0,1 mm' is no number with a unit: its number is not a plain one; write "0.1 mm\"""",
        ),
        (["--restitution", "0.1 m"], "numbers here are in SI units, without a unit: 0.1"),
        (["--t1", "5 m"], "argument --t1: '5 m' is a length [m], but a time [s] is expected"),
        (["--clearence", "1e-4"], "unrecognized arguments: --clearence 1e-4; did you mean --clearance?"),
        (["--stiffness", "1e999"], "argument --stiffness: '1e999' is larger than any number"),
        (["--t1", "inf"], "argument --t1: 'inf' is no number"),
        (["--samples", "2.5"], "argument --samples: '2.5' is no whole number"),
    ],
)
def test_a_number_is_a_plain_one_or_the_option_says_what_to_write(words, message, capsys):
    assert cli.main(["run", "four-bar", "--joint", "dry", *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


TOLERANCES = ["tolerances", "four-bar", "--of", "position.rocker.z", "--tolerance"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rigg", "mcpherson"], "invalid choice: 'rigg'; did you mean 'rig'?"),
        (["modes", "four-bar", "--joint", "bushin"], "invalid choice: 'bushin'; did you mean 'bushing'?"),
        (["cycle", "piston", "--perod", "0.01"], "is required; unrecognized: --perod; did you mean --period?"),
        (["cycle", "piston", "--period", "-1"], "argument --period: '-1' must be positive"),
        (["export", "four-bar", "--outputt", "position.rocker"], "unrecognized: --outputt; did you mean --output?"),
        (["export", "four-bar", "--output", "position.rocker", "--fmu", "a.txt"], "argument --fmu: 'a.txt' is no FMU"),
        ([*TOLERANCES, "stiffness=3"], "stiffness=3: say how much, e.g. stiffness=3+-1%"),
        ([*TOLERANCES, "+-1%"], "+-1%: write NAME=MIDDLE+-WIDTH"),
    ],
)
def test_what_is_misspelled_is_told_before_anything_is_made(words, message, capsys, monkeypatch):
    monkeypatch.setattr(sj.gallery, "four_bar", lambda *a, **k: pytest.fail("made in vain"))
    assert cli.main(words) == 2
    said = " ".join(capsys.readouterr().err.split())
    said = re.sub(r" \(choose from [^)]*\)", "", said)
    assert message in said


@pytest.mark.parametrize(
    ("given", "said"), [("--watch", ""), ("--atoll", "; did you mean --atol?"), ("-atol", "; did you mean --atol?")]
)
def test_an_option_that_resembles_none_is_taken_for_none(given, said):
    parser = argparse.ArgumentParser()
    parser.add_argument("--atol")
    assert cli.meant([given], parser) == said


def test_a_warning_of_ours_is_a_sentence_and_not_a_place_in_our_code():
    assert cli._in_one_line("so\n far", sj.errors.StartWarning, "a.py", 3) == "spherejax: warning: so far\n"
    assert cli._in_one_line("so", UserWarning, "a.py", 3).startswith("a.py:3: UserWarning: so")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mu=0,1:0.3:4", "--vary mu=0,1:0.3:4: '0,1' is no number; write 0.1"),
        ("mu=0.1:0.3:2.5", "N = 2.5 must be a whole number, at least 1"),
        ("clearance=0.1kg:0.2mm:3", "'0.1kg' is a mass [kg], but a length [m] is expected"),
        (
            "friction.v1=1kg:2kg:2",
            "friction.v1=1kg:2kg:2: '1kg' is a mass [kg], but a velocity [m/s] is expected",
        ),
        ("mu=0.1 mm:0.3:2", "numbers here are in SI units, without a unit"),
        ("mu=0.1;0.2", "'0.1;0.2' is no number"),
    ],
)
def test_a_number_that_is_varied_is_a_plain_one(given, message, capsys, tmp_path):
    words = ["sweep", "four-bar", "--joint", "friction", "--vary", given, "--out", str(tmp_path / "s.zarr")]
    assert cli.main(words) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("clearance=0.1 mm:0.2mm:3", [1e-4, 1.5e-4, 2e-4]),
        ("clearance=0.1 mm,1e-3", [1e-4, 1e-3]),
        ("rocker.mass=20 g:30g:2:log", [0.02, 0.03]),
    ],
)
def test_a_number_that_is_varied_may_have_a_unit(given, meant):
    words = ["sweep", "four-bar", "--joint", "friction", "--vary", given, "--out", "s.zarr"]
    options = cli.parser().parse_args(words)
    asked = asked_of(options)
    assert asked.shown.popitem()[1].unit == given.partition("=")[2].split()[1].partition(":")[0].partition(",")[0]
    grid = asked.grid(options)
    np.testing.assert_allclose(next(iter(grid.axes.values())), meant, rtol=1e-12)


def test_where_a_fit_begins_and_what_is_changed_may_have_units(capsys):
    from spherejax.command_line.sensitivity import _parameters
    from spherejax.command_line.unknowns import starts_of

    words = ["fit", "four-bar", "--joint", "bushing", "--measured", "x.csv", "--start"]
    start = starts_of(cli.parser().parse_args([*words, "stiffness=10 kN/m:1 kN/m:1e7", "--start", "rocker.mass=20 g"]))
    assert (start["stiffness"].parameter.lower, start["stiffness"].start, start["rocker.mass"].start) == (
        1e3,
        1e4,
        0.02,
    )
    assert cli.main([*words, "rocker.mass=20 mm"]) == 2
    assert "--start rocker.mass=20 mm: '20 mm' is a length [m], but a mass [kg] is expected" in capsys.readouterr().err
    words = ["sensitivity", "four-bar", "--joint", "bushing", "--of", "position.rocker", "--by"]
    assert _parameters(cli.parser().parse_args([*words, "stiffness=10 kN/m"]))[0] == {"stiffness": 1e4}
    assert cli.main([*words, "rocker.mass=20 mm"]) == 2
    assert "--by rocker.mass=20 mm: '20 mm' is a length [m]" in capsys.readouterr().err


def test_a_failed_run_exits_with_3_and_says_why(capsys):
    assert cli.main(["run", "four-bar", "--t1", "0.5", "--samples", "5", "--max-steps", "2"]) == 3
    err = capsys.readouterr().err
    assert "the run failed: stopped at t = " in err
    assert "max_steps" in err


def test_version_says_what_computes(capsys):
    import importlib.metadata

    assert cli.main(["--version"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"spherejax {importlib.metadata.version('spherejax')} (Python {sys.version.split()[0]}")
    assert f"jaxlib {importlib.metadata.version('jaxlib')}" in said
    assert said.count("\n") == 1


def test_an_interrupt_exits_with_130(capsys, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(sj, "simulate", interrupt)
    assert cli.main(["run", "four-bar"]) == 130
    assert capsys.readouterr().err == "spherejax: interrupted\n"


@pytest.mark.usefixtures("hears_interrupts")
def test_an_interrupt_in_a_collection_of_garbage_is_heard(capsys, monkeypatch):
    """Python drops what is raised in a callback, and JAX has one for each collection of garbage."""

    def interrupted_once(phase, info):
        gc.callbacks.remove(interrupted_once)
        raise KeyboardInterrupt

    def collect(*arguments, **options):
        gc.callbacks.append(interrupted_once)
        gc.collect()
        for _ in range(200):
            time.sleep(0.01)
        raise AssertionError("the interrupt was lost")

    monkeypatch.setattr(sj, "simulate", collect)
    hook = sys.unraisablehook
    assert cli.main(["run", "four-bar"]) == 130
    assert capsys.readouterr().err == "spherejax: interrupted\n"
    assert sys.unraisablehook is hook


def test_joint_words_become_models():
    assert isinstance(model_from(parsed()), sj.Ideal)
    dry = model_from(parsed("--joint", "dry"))
    assert isinstance(dry, sj.Dry)
    assert dry.friction is None
    assert dry.normal.restitution == 0.9
    friction = model_from(parsed("--joint", "friction", "--mu", "0.2", "--clearance", "2e-4"))
    assert isinstance(friction.friction, sj.Threlfall)
    assert (friction.friction.mu, friction.clearance) == (0.2, 2e-4)
    lubricated = model_from(parsed("--joint", "lubricated", "--boundary", "sommerfeld"))
    assert isinstance(lubricated.boundary, sj.Sommerfeld)
    assert lubricated.viscosity == 0.4
    assert isinstance(lubricated.film, sj.laws.FullFilm)
    assert isinstance(model_from(parsed("--joint", "lubricated", "--film", "radial")).film, sj.laws.RadialFilm)
    with pytest.raises(sj.SceneError, match="PinkusSternlicht"):
        model_from(parsed("--joint", "lubricated", "--film", "full", "--boundary", "pinkus-sternlicht"))
    bushing = model_from(parsed("--joint", "bushing", "--elastomer", "vector", "--stiffness", "2e5"))
    assert isinstance(bushing.law, sj.laws.VectorElastomer)
    assert (bushing.law.stiffness, bushing.law.damping) == (2e5, 1e-2)


def test_a_bearing_has_a_length_and_laws_of_cylinders():
    dry = model_from(parsed("--joint", "dry", "--length", "20 mm"))
    assert isinstance(dry.conformity, sj.laws.JohnsonCylinder)
    assert dry.conformity.length == pytest.approx(0.02)
    short = model_from(parsed("--joint", "lubricated", "--length", "0.01"))
    long = model_from(parsed("--joint", "lubricated", "--length", "0.04", "--film", "long"))
    assert (type(short.film), type(long.film)) == (sj.laws.ShortBearing, sj.laws.LongBearing)
    for words, said in (
        (("--joint", "lubricated", "--film", "short"), "needs --length"),
        (("--joint", "lubricated", "--film", "full", "--length", "0.02"), "leave --length out"),
        (("--joint", "bushing", "--length", "0.02"), "--length means nothing"),
    ):
        with pytest.raises(sj.SceneError, match=said):
            model_from(parsed(*words))


@pytest.mark.slow
def test_a_piston_runs_with_play_in_its_pin(tmp_path, capsys):
    words = ["--joint", "dry", "--clearance", "0.5 mm", "--length", "20 mm", "--t1", "2 ms", "--samples", "5"]
    assert (
        cli.main(["run", "piston", *words, "--out", str(tmp_path / "run.nc"), "--impacts", str(tmp_path / "i.csv")])
        == 0
    )
    assert "pin" in capsys.readouterr().out
    assert len((tmp_path / "i.csv").read_text().splitlines()) > 2


@pytest.mark.parametrize("name", NORMAL_LAWS)
def test_every_normal_law_can_be_named(name):
    assert isinstance(model_from(parsed("--joint", "dry", "--normal", name)).normal, NORMAL_LAWS[name])


@pytest.mark.parametrize("name", FRICTION_LAWS)
def test_every_friction_law_can_be_named_and_takes_mu(name):
    law = model_from(parsed("--joint", "dry", "--friction", name, "--mu", "0.05")).friction
    assert isinstance(law, FRICTION_LAWS[name])
    assert getattr(law, "mu", None) == 0.05 or law.mu_kinetic == 0.05


def test_list_names_everything(capsys):
    assert cli.main(["list"]) == 0
    out = capsys.readouterr().out
    for name in ("four-bar", "lubricated", *NORMAL_LAWS, *FRICTION_LAWS, *SOLVERS, "guembel", "cosine-pressure"):
        assert name in out
    assert "mu = 0.1 [-], v1 = 0.001 [m/s]" in out


def test_list_shows_only_what_contains_a_word(capsys):
    assert cli.main(["list", "pid"]) == 0
    out = capsys.readouterr().out
    assert "sampled-pid" in out
    assert "proportional" in out  # a kind that is called so is shown whole
    assert "four-bar" not in out
    assert cli.main(["list", "xyzzy"]) == 2
    assert "nothing that can be asked for contains 'xyzzy'" in capsys.readouterr().err


def test_every_scene_of_the_gallery_has_its_name():
    scenes = {getattr(sj.gallery, name) for name in sj.gallery.__all__}
    assert set(catalog.SCENES.values()) == scenes
    assert set(catalog.USUAL) < set(catalog.SCENES)
    assert set(catalog.ALIASES.values()) < set(catalog.SCENES)


@pytest.mark.parametrize(
    ("table", "family"),
    [
        ("NORMAL_LAWS", sj.laws.AbstractNormalLaw),
        ("FRICTION_LAWS", sj.laws.AbstractFrictionLaw),
        ("FILMS", sj.laws.AbstractFilm),
        ("BOUNDARIES", sj.laws.AbstractFilmBoundary),
        ("ELASTOMERS", sj.laws.AbstractElastomer),
        ("DRIFT_CONTROLS", sj.solvers.AbstractDriftControl),
        ("SOLVERS", diffrax.AbstractSolver),
    ],
)
def test_names_stand_for_parts(table, family):
    parts = getattr(catalog, table)
    assert parts
    assert all(issubclass(part, family) for part in parts.values())
    assert "no-such-part" not in parts
    with pytest.raises(KeyError):
        parts["no-such-part"]


@pytest.mark.parametrize("name", catalog.SUBJECTS)
def test_mechanisms_that_are_compared_have_their_names(name):
    assert catalog.SUBJECTS[name].name == name


def test_effects_prints_a_table(capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("spherejax.studies.effects.effects", lambda scene: asked.append(scene) or "the table")
    assert cli.main(["effects", "four-bar", "--joint", "friction"]) == 0
    assert capsys.readouterr().out == "the table\n"
    assert isinstance(asked[0].joints["coupler_rocker"].model, sj.Dry)


def test_compare_writes_table_files_and_figures(tmp_path, capsys, monkeypatch):
    run = sj.simulate(sj.gallery.four_bar(), np.linspace(0.0, 0.01, 5))
    row = ModelRow("ideal", "ideal", 0.0, 9.0, 0.0, None, 5, 0.01, 1.0, None, run.choice)
    curves = {"ideal": curves_of(run, "ideal", body="rocker", joint="coupler_rocker")}
    found = Comparison(0.01, [row], curves, {"ideal": run}, subject=FOUR_BAR)
    only = {name: draw for name, draw in figures(found).items() if name.startswith(("fig07", "fig21"))}

    def compared(subject, *, quick, report, meanwhile):
        """One of the figures that need no run has been drawn when this returns, and one of the files written."""
        next(meanwhile.ahead)
        next(meanwhile.as_found(lambda: found))
        report("done", 1.0)
        return found

    monkeypatch.setattr("spherejax.studies.compare.compare_models", compared)
    monkeypatch.setattr("spherejax.command_line.figures.figures_of", lambda comparison: only)
    folder = tmp_path / "results"
    assert cli.main(["compare", "four-bar", "--quick", "--out", str(folder)]) == 0
    seen = capsys.readouterr()
    assert "energy lost [mJ]" in seen.out
    assert "[ 90 %] done" in seen.err
    assert {p.name for p in folder.iterdir()} == {
        "table.csv", "ideal.nc", "fig06_normal_laws.png", "fig07_friction_laws.png", "fig21_time_ratio.png",
    }  # fmt: skip
    assert (folder / "fig07_friction_laws.png").read_bytes().startswith(b"\x89PNG")
    with (folder / "table.csv").open() as file:
        assert next(csv.DictReader(file))["model"] == "ideal"
    with xarray.open_dataset(folder / "ideal.nc") as ds:
        assert ds.position.shape == (5, 3, 3)
    assert cli.main(["compare", "four-bar", "--out", str(folder)]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.slow
def test_the_quick_comparison_keeps_the_order_of_the_losses():
    found = compare_models(FOUR_BAR, quick=True)
    lost = {row.name: row.lost_energy for row in found.rows}
    # The paper's order has the dry joint before the lubricated one, whose film shears no oil.
    assert lost["friction"] > lost["lubricated"] > lost["dry"] > lost["bushing"] > abs(lost["ideal"])
    ratios = {row.name: row.eccentricity_ratio for row in found.rows}
    assert ratios["dry"] > 1 > ratios["lubricated"]
    assert all(row.seconds > 0 for row in found.rows)
    assert found.determined_until == dict.fromkeys(lost)  # all until the end: 0.2 s
    assert [result.study.name for result in found.studies] == ["dry_clearance"]
    assert len(found.models["dry"].ts) == 20001


def figures(comparison):
    from spherejax.command_line.figures import figures_of

    return figures_of(comparison)


def test_the_command_is_installed_and_import_stays_light():
    code = "import sys, spherejax; print('matplotlib' in sys.modules, 'xarray' in sys.modules)"
    seen = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert seen.stdout.split()[0] == "False"
    seen = subprocess.run(
        [sys.executable, "-m", "spherejax.cli", "run", "four-bar", "--t1", "0"],
        capture_output=True,
        text=True,
    )
    assert seen.returncode == 2
    assert "--t1 = 0 must be a positive time" in seen.stderr


ARM = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/><dynamics damping="0.1" friction="0.3"/></joint></robot>"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return str(path)


def test_robots_take_the_arguments_of_load_urdf_as_options(arm, tmp_path, capsys):
    out = tmp_path / "arm.toml"
    words = ["--friction", "threlfall v1=0.01", "--stops", "turning=500", "--positions", "elbow=30 deg"]
    words += ["--velocities", "elbow=0.5", "--least-mass", "10 g", "--base", "ground"]
    assert cli.main(["write", arm, *words, "--out", str(out)]) == 0
    expected = sj.load_urdf(
        arm,
        friction=sj.Threlfall(v1=0.01),
        stops={"turning": 500.0},
        positions={"elbow": np.pi / 6},
        velocities={"elbow": 0.5},
    )
    found = sj.load_scene(out)
    assert found.joints["elbow"].model.friction.v1 == 0.01
    assert set(found.forces) == set(expected.forces) == {"elbow", "elbow_stop"}
    np.testing.assert_allclose(found.bodies["arm"].quaternion, expected.bodies["arm"].quaternion, atol=1e-15)
    np.testing.assert_array_equal(found.bodies["arm"].angular_velocity, expected.bodies["arm"].angular_velocity)


def test_stops_have_units_and_a_restitution(arm, tmp_path):
    out = tmp_path / "arm.toml"
    for text, how in (
        ("elbow=500 N m/rad", 500.0),
        ("elbow=0.5 kN m/rad", 500.0),
        ("turning=2 N mm/deg:0.5", {"stiffness": 2e-3 * 180 / np.pi, "restitution": 0.5}),
        ("turning=500,elbow=none", None),
    ):
        words = ["--ignore", "friction", "--stops", text, "--out", str(out), "--overwrite"]
        assert cli.main(["write", arm, *words]) == 0
        expected = sj.load_urdf(arm, ignore=("friction",), stops={"elbow": how}).forces
        found = sj.load_scene(out).forces
        assert set(found) == set(expected)
        if how is not None:
            assert type(found["elbow_stop"]) is type(expected["elbow_stop"])
            assert found["elbow_stop"].stiffness == pytest.approx(float(expected["elbow_stop"].stiffness))
            assert getattr(found["elbow_stop"], "restitution", None) == (
                how["restitution"] if isinstance(how, dict) else None
            )


def test_a_model_of_mujoco_is_a_scene_of_the_command_line(tmp_path, capsys):
    pytest.importorskip("mujoco")
    path, out = tmp_path / "arm.xml", tmp_path / "arm.toml"
    path.write_text(
        '<mujoco><worldbody><body name="arm"><joint name="j" axis="0 1 0" armature="0.1"/>'
        '<geom size="0.1" pos="0 0 -0.3"/></body></worldbody>'
        '<keyframe><key name="up" qpos="1.5"/></keyframe></mujoco>'
    )
    assert cli.main(["write", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "armature: j" in said
    assert "Leave it out with --ignore armature" in said
    assert "load_mjcf" not in said
    assert cli.main(["write", str(path), "--ignore", "armature", "--keyframe", "up", "--out", str(out)]) == 0
    np.testing.assert_allclose(sj.load_scene(out).bodies["arm"].quaternion, [np.cos(0.75), 0, np.sin(0.75), 0])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--positions", "elbow=1cm", "--ignore", "friction"], "joint 'elbow' is measured in rad, not in m"),
        (["--positions", "elbow", "--ignore", "friction"], "'elbow' is no NAME=VALUE"),
        (["--positions", "elbow=3kg", "--ignore", "friction"], "with a unit of rad or m or without"),
        (["--positions", "elbo=1", "--ignore", "friction"], "did you mean 'elbow'"),
        (["--ignore", "frictoin"], "did you mean 'friction'"),
        (["--keyframe", "up"], "--keyframe is for .xml and .mjcf"),
        (["--stops", "turning=soft", "--ignore", "friction"], "must be a number, with a unit of N m/rad or without"),
        (["--stops", "elbow=5 N/mm", "--ignore", "friction"], "joint 'elbow' is measured in N m/rad, not in N/m"),
        (["--stops", "elbow=5 mm", "--ignore", "friction"], "with a unit of N m/rad or N/m or without"),
        (["--stops", "elbow=5:bouncy", "--ignore", "friction"], "'bouncy'"),
        (["--mimic", "sliding=1e4:5", "--ignore", "friction", "--fixed", "wrist"], "there is no joint 'wrist'"),
        ([], "--ignore friction"),
        (["--friction", "threlfall v2=1"], "threlfall has no number 'v2'"),
        (["--friction", "threlfal"], "did you mean 'threlfall'"),
    ],
)
def test_options_of_robots_that_say_nothing_are_refused(arm, tmp_path, capsys, words, said):
    assert cli.main(["write", arm, *words, "--out", str(tmp_path / "a.toml")]) == 2
    assert said in capsys.readouterr().err


def test_options_of_robots_are_refused_elsewhere(capsys):
    assert cli.main(["run", "four-bar", "--fixed", "elbow"]) == 2
    assert "--fixed is for robot descriptions (.urdf, .xml, .mjcf), and four-bar is none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "number"),
    [(("--stiffness", "1e5"), "5e-05 s"), ((), "5e-06 s")],
)
def test_a_damping_coefficient_is_told_its_ratio_to_the_stiffness(words, number, capsys):
    """A bushing's damping is c/k: who gives c [N s/m] reads what to give, by the stiffness that would be used."""
    assert cli.main(["run", "four-bar", "--joint", "bushing", "--damping", "5 N s/m", *words]) == 2
    said = capsys.readouterr().err
    assert "--damping 5 N s/m: the damping of a bushing is given by its ratio to the stiffness, c/k [s]" in said
    assert f'it is --damping "{number}"' in said
    assert model_from(parsed("--joint", "bushing", "--damping", "5 ms")).law.damping == pytest.approx(5e-3)


def test_a_damping_coefficient_has_no_ratio_to_a_stiffness_of_zero(capsys):
    assert cli.main(["run", "four-bar", "--joint", "bushing", "--damping", "5 N s/m", "--stiffness", "0"]) == 2
    assert "give a positive --stiffness" in capsys.readouterr().err
