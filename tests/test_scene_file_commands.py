"""Scene files on the command line: run, write, list, effects and accuracy."""

import re
from functools import partial
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from double_pendulum import TEXT, write

import spherejax as sj
from spherejax import cli
from spherejax.command_line.scenes import model_name
from spherejax.files.fields.dimensions import FIELDS
from spherejax.files.fields.objects import same
from spherejax.foundations.parts import kebab


@pytest.fixture
def written(tmp_path):
    """Writes a text to a scene file, with replacements."""
    return partial(write, tmp_path)


def test_a_file_runs_from_the_command_line_as_it_says(written, tmp_path, capsys):
    path, out = written(), tmp_path / "run.nc"
    assert cli.main(["run", str(path), "--out", str(out)]) == 0
    expected = sj.simulate(sj.load_scene(path), jnp.linspace(0.0, 0.04, 5), rtol=1e-6, solver=diffrax.Dopri8())
    with xarray.open_dataset(out) as ds:
        np.testing.assert_array_equal(ds.position.sel(body="lower"), expected.position("lower"))
    seen = capsys.readouterr().out
    assert "double pendulum with a dry elbow, as described, 0.04 s" in seen
    assert "contact onsets of elbow" in seen


def readme_block(language: str) -> str:
    """The double pendulum of the README."""
    text = (Path(__file__).parents[1] / "README.md").read_text()
    return re.search(rf"<!-- double pendulum in \w+ -->\n\n```{language}\n(.*?)```", text, re.DOTALL).group(1)


def test_the_readme_says_the_same_in_python_and_in_a_file(tmp_path, capsys):
    python, toml = readme_block("python"), readme_block("toml")
    assert len(python.strip().splitlines()) < 20
    described: dict = {}
    exec(python, described)
    path, out = tmp_path / "pendulum.toml", tmp_path / "run.nc"
    path.write_text(toml)
    scene = sj.load_scene(path)
    assert jax.tree.structure(scene) == jax.tree.structure(described["scene"])
    for one, other in zip(jax.tree.leaves(scene), jax.tree.leaves(described["scene"]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15)
    assert cli.main(["run", str(path), "--out", str(out)]) == 0
    run = described["run"]
    with xarray.open_dataset(out) as ds:
        np.testing.assert_allclose(ds.position.sel(body="lower"), run.position("lower"), atol=1e-6)
    wrong = path.with_name("wrong.toml")
    wrong.write_text(toml.replace('"0.1 mm"', '"3 N"'))
    assert cli.main(["run", str(wrong)]) == 2
    promised = "pendulum.toml:21: joints.elbow.model.clearance: '3 N' is a force [N], but a length [m] is expected"
    assert promised.replace("pendulum", "wrong") in capsys.readouterr().err
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    assert promised in " ".join(readme.split())


def test_a_bad_file_is_one_readable_line(written, capsys, monkeypatch):
    monkeypatch.setattr(sj, "simulate", lambda *a, **k: pytest.fail("simulated in vain"))
    path = written(TEXT, ('clearance = "0.1 mm"', 'clearance = "35.9 kN/m"'))
    assert cli.main(["run", str(path)]) == 2
    assert capsys.readouterr().err == (
        f"spherejax: {path}:33: joints.elbow.model.clearance: '35.9 kN/m' is a stiffness [N/m], "
        "but a length [m] is expected\n"
    )


@pytest.fixture
def asked(monkeypatch):
    """What a command would simulate."""
    seen = []

    def stop(scene, ts, **options):
        seen.append((scene, ts, options))
        raise sj.SceneError("seen")

    monkeypatch.setattr(sj, "simulate", stop)
    return seen


@pytest.mark.parametrize(
    ("words", "t1", "n", "rtol"),
    [
        ((), 0.04, 5, 1e-6),
        (("--t1", "0.5", "--rtol", "1e-9"), 0.5, 5, 1e-9),
        (("--dt", "0.01"), 0.04, 5, 1e-6),
        (("--samples", "3"), 0.04, 3, 1e-6),
    ],
)
def test_options_come_before_the_file_and_the_file_before_the_defaults(written, asked, words, t1, n, rtol):
    assert cli.main(["run", str(written()), *words]) == 2
    _, ts, options = asked[0]
    assert (float(ts[-1]), len(ts), options["rtol"]) == (t1, n, rtol)
    assert type(options["solver"]).__name__ == "Dopri8"
    assert options["max_steps"] == 20_000_000


def test_the_number_of_samples_asked_for_comes_before_their_interval_in_the_file(written, asked):
    path = str(written(TEXT, ("samples = 5", 'dt = "1 ms"')))
    assert cli.main(["run", path]) == 2
    assert cli.main(["run", path, "--samples", "3"]) == 2
    assert [len(ts) for _, ts, _ in asked] == [41, 3]


def test_joint_options_replace_the_model_of_the_studied_joint_or_another(written, asked):
    path = str(written())
    dry = ("--joint", "dry", "--of", "shoulder", "--clearance", "2e-4")
    words = (("--joint", "bushing"), dry, ("--drift", "projection"))
    for word in words:
        assert cli.main(["run", path, *word]) == 2
    studied, other, drift = (scene for scene, _, _ in asked)
    assert isinstance(studied.joints["elbow"].model, sj.Bushing)
    assert isinstance(studied.joints["shoulder"].model, sj.Ideal)
    assert isinstance(other.joints["elbow"].model, sj.Dry)
    assert other.joints["shoulder"].model.clearance == 2e-4
    assert same(drift.joints, sj.load_scene(path).joints)
    assert isinstance(drift.drift, sj.solvers.Projection)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--of", "elbo"], "--of elbo: there is no such joint; did you mean 'elbow'?"),
        (["--clearance", "1e-4"], "--clearance changes nothing without --joint"),
        (["--joint", "bushing", "--mu", "0.1"], "--mu means nothing with --joint bushing"),
    ],
)
def test_joint_options_that_make_no_sense_are_refused(written, asked, capsys, words, message):
    assert cli.main(["run", str(written()), *words]) == 2
    assert message in capsys.readouterr().err
    assert not asked


@pytest.mark.parametrize(("name", "title"), [("four-bar", "ideal"), ("hip", "as described"), ("chain", "as described")])
def test_titles_say_which_model_a_scene_of_the_gallery_has(name, title, asked, capsys):
    options = cli.parser().parse_args(["run", name])
    assert model_name(options) == title
    assert cli.main(["run", name, "--clearance", "1e-4"]) == 2
    expected = "means nothing with --joint ideal" if title == "ideal" else "changes nothing without --joint"
    assert expected in capsys.readouterr().err
    assert not asked


def test_a_model_needs_a_joint(written, asked, capsys):
    path = written(TEXT, ("studied = true", ""))
    assert cli.main(["run", str(path), "--joint", "dry"]) == 2
    assert "scene.toml marks no joint with studied = true; add --of NAME" in capsys.readouterr().err
    revolute = '\n[joints.pin]\nkind = "revolute"\nbodies = ["ground", "upper"]\npoint = [0, 0, 0]\naxis = [0, 1, 0]\n'
    path = written(TEXT + revolute)
    assert cli.main(["run", str(path), "--joint", "gum", "--of", "pin"]) == 2
    assert not asked


def test_effects_and_accuracy_take_a_file(written, monkeypatch, capsys):
    seen = []
    monkeypatch.setattr("spherejax.studies.effects.effects", lambda scene: seen.append(scene) or "the table")
    path = str(written())
    assert cli.main(["effects", path]) == 0
    assert same(seen[0], sj.load_scene(path))

    def stop(scenes, **options):
        seen.append(scenes)
        raise sj.SceneError("seen")

    monkeypatch.setattr(sj, "work_precision", stop)
    assert cli.main(["accuracy", path]) == 2
    assert cli.main(["accuracy", path, "--models", "ideal", "bushing"]) == 2
    assert same(seen[1], {"as described": sj.load_scene(path)})
    assert [type(scene.joints["elbow"].model) for scene in seen[2].values()] == [sj.Ideal, sj.Bushing]


def test_write_gives_a_file_to_start_from(tmp_path, capsys, asked):
    path = tmp_path / "four_bar.toml"
    assert cli.main(["write", "four-bar", "--joint", "friction", "--out", str(path)]) == 0
    assert capsys.readouterr().out == f"wrote {path}\n"
    model = sj.Dry(1e-4, friction=sj.Threlfall())
    assert same(sj.load_scene(path), sj.gallery.four_bar(model))
    assert cli.main(["write", "four-bar", "--out", str(path)]) == 2
    assert "exists" in capsys.readouterr().err
    assert cli.main(["run", str(path), "--joint", "lubricated"]) == 2
    assert isinstance(asked[0][0].joints["coupler_rocker"].model, sj.Lubricated)
    again = tmp_path / "again.toml"
    assert cli.main(["write", str(path), "--out", str(again)]) == 0
    assert again.read_text() == path.read_text()


def test_list_names_kinds_keys_and_units(capsys):
    assert cli.main(["list", "--kinds"]) == 0
    out = capsys.readouterr().out
    assert {kebab(cls.__name__) for cls in FIELDS if cls is not sj.Body} <= set(re.findall(r"[a-z0-9-]+", out))
    for words in ("mass *", "[N/m^exponent]", '"body.point"', "angular_velocity", "rotation may stand", "t1"):
        assert words in out
