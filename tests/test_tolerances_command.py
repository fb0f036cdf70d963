"""`spherejax tolerances`: what it takes for a spread, what it refuses, and that it says what the study says."""

import csv
import re

import equinox as eqx
import numpy as np
import pytest

import spherejax as sj
from spherejax import cli
from spherejax.command_line import tolerances
from spherejax.model.numbers import number_at

BUSHING = ("tolerances", "four-bar", "--joint", "bushing", "--stiffness", "1e5", "--damping", "1e-3")


class Asked(Exception):  # noqa: N818
    """Ends a command where the study would begin."""


@pytest.fixture
def asked(monkeypatch):
    """What the study is asked, without its runs."""

    def of(*words):
        found = []

        def study(options, build, spreads, observables):
            found.append((options, build, spreads))
            raise Asked

        monkeypatch.setattr(tolerances, "_study", study)
        with pytest.raises(Asked):
            cli.main([*BUSHING, *words])
        return found[0]

    return of


OF = ("--of", "position.rocker.z")


def test_spreads_have_units_and_middles(asked):
    _, build, spreads = asked(
        "--tolerance", "stiffness=+-20%", "--tolerance", "rocker.mass=30 g+-0.5g", "--tolerance", "gravity.z=-9.9:-9.7",
        *OF,
    )  # fmt: skip
    assert spreads["stiffness"] == sj.studies.Tolerance(1e5, 2e4)
    assert spreads["rocker_mass"].nominal == pytest.approx(0.03)
    assert spreads["rocker_mass"].half_width == pytest.approx(5e-4)
    assert spreads["gravity_z"] == (-9.9, -9.7)
    scene = build(stiffness=2e5, rocker_mass=0.04, gravity_z=-9.75)
    assert number_at(scene, "joints.coupler_rocker.model.stiffness").value(scene) == 2e5
    assert float(scene.bodies["rocker"].mass) == 0.04
    np.testing.assert_array_equal(scene.gravity, (0.0, 0.0, -9.75))


def test_uniform_limits(asked):
    _, _, spreads = asked("--tolerance", "damping=+-10%", "--uniform", *OF)
    assert spreads["damping"] == sj.studies.Tolerance(1e-3, 1e-4, "uniform")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--tolerance", "stiffnes=+-1%"), ["--tolerance", "stiffnes", "stiffness"]),
        (("--tolerance", "stiffness"), ["NAME=MIDDLE+-WIDTH"]),
        (("--tolerance", "stiffness=1e5"), ["stiffness=1e5", "1e5+-1%"]),
        (("--tolerance", "stiffness=+-2 kg"), ["2 kg", "a mass", "a stiffness"]),
        (("--tolerance", "stiffness=+-0"), ["half_width", "positive"]),
        (("--tolerance", "stiffness=+-x%"), ["no number"]),
        (("--tolerance", "stiffness=+-1%", "--tolerance", "joints.coupler_rocker.model.stiffness=+-2%"), ["twice"]),
        (("--tolerance", "gravity=+-1%"), ["gravity", "3 numbers", "gravity.x"]),
        (("--tolerance", "stiffness=+-1%", "--runs", "8"), ["--runs 8", "--method sobol"]),
    ],
)
def test_requests_that_make_no_sense(capsys, words, said):
    assert cli.main([*BUSHING, *words, *OF]) == 2
    told = capsys.readouterr().err
    for word in said:
        assert word in told


def test_files_are_not_replaced_and_known_before_the_work(capsys, tmp_path):
    (tmp_path / "tolerances.csv").write_text("mine")
    assert cli.main([*BUSHING, "--tolerance", "stiffness=+-1%", *OF, "--out", str(tmp_path)]) == 2
    assert "exists" in capsys.readouterr().err
    assert (tmp_path / "tolerances.csv").read_text() == "mine"


@pytest.mark.slow
def test_it_says_what_the_study_says(capsys, tmp_path):
    words = ("--tolerance", "stiffness=+-20%", "--tolerance", "rocker.mass=+-0.5g", "--t1", "0.05", "--samples", "11")
    assert cli.main([*BUSHING, *words, *OF, "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "Tolerance budget" in told
    assert re.search(r"rocker_mass +31.6 +0.5 +0.16\d +g", told)
    assert re.search(r"stiffness +100000 .* N/m", told)

    def build(stiffness, rocker_mass):
        scene = sj.gallery.four_bar(sj.Bushing(stiffness, 1e-3))
        return eqx.tree_at(lambda s: s.bodies["rocker"].mass, scene, rocker_mass)

    mass = float(sj.gallery.four_bar().bodies["rocker"].mass)
    spreads = {"stiffness": sj.studies.Tolerance(1e5, 2e4), "rocker_mass": sj.studies.Tolerance(mass, 5e-4)}
    ts = np.linspace(0.0, 0.05, 11)
    budget = sj.studies.tolerance_budget(build, spreads, ts, observables=["position.rocker.z"])
    with (tmp_path / "tolerances.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = np.array([float(row["deviation.position.rocker.z [m]"]) for row in rows])
    np.testing.assert_allclose(found, budget.of("position.rocker.z").deviation[:, 0], rtol=1e-6, atol=1e-20)
    assert sj.load(tmp_path / "tolerances.nc").sizes["time"] == 11
    assert {path.name for path in tmp_path.glob("*.png")} == {"position_rocker_z.png", "shares.png"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "runs", "said"), [("sobol", 8, "Shares of the variance"), ("samples", 16, "Scatter")]
)
def test_methods_of_many_runs(capsys, tmp_path, method, runs, said):
    words = ("--tolerance", "stiffness=+-20%", "--tolerance", "rocker.mass=+-0.5g", "--t1", "0.05", "--samples", "11")
    of = ("--of", "final position.rocker.z", "--method", method, "--runs", str(runs))
    assert cli.main([*BUSHING, *words, *of, "--out", str(tmp_path)]) == 0
    assert said in capsys.readouterr().out
    with (tmp_path / "tolerances.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == {"sobol": 2, "samples": 16}[method]
    assert [row.get("parameter") for row in rows[:2]] == {"sobol": ["stiffness", "rocker_mass"]}.get(
        method, [None, None]
    )
    assert list(tmp_path.glob("*.png"))


SHORT = ("--tolerance", "stiffness=+-20%", "--t1", "0.01", "--samples", "3")


@pytest.mark.parametrize("method", ["budget", pytest.param("samples", marks=pytest.mark.slow)])
def test_what_is_observed_is_told_in_its_unit(capsys, tmp_path, method):
    """In the table, the file and the pictures; the check of the budget does not depend on it."""
    quantity = {"budget": "position.rocker.z", "samples": "final position.rocker.z"}[method]
    more = ("--method", method) if method == "budget" else ("--method", method, "--runs", "4")
    tables, said = [], []
    for unit in ("", " [um]"):
        out = tmp_path / unit.strip(" []")
        assert cli.main([*BUSHING, *SHORT, *more, "--of", f"{quantity}{unit}", "--out", str(out)]) == 0
        said.append(capsys.readouterr().out)
        with (out / "tolerances.csv").open() as file:
            tables.append([*csv.reader(file)])
    (heads, *rows), (heads_um, *rows_um) = tables
    lengths = np.array(["[m" in head for head in heads])
    assert np.any(lengths)
    assert heads_um == [head.replace("[m", "[um") for head in heads]
    factor = np.where(lengths, 1e6, 1.0)
    np.testing.assert_allclose(np.array(rows_um, float), np.array(rows, float) * factor, rtol=1e-9)
    told = [line for line in said[1].splitlines() if line.startswith(quantity.replace(" ", "_"))]
    assert told
    assert all(" um" in line for line in told)
    assert [line for line in said[0].splitlines() if "hecked" in line] == [
        line for line in said[1].splitlines() if "hecked" in line
    ]


def test_a_unit_of_another_dimension_is_refused_before_the_work(capsys):
    assert cli.main([*BUSHING, *SHORT, "--of", "position.rocker.z [N]"]) == 2
    assert "a length [m] is expected" in capsys.readouterr().err
