"""Any number of a scene by its path on the command line: `--set`, `--vary`, `--by`, `--start`."""

import jax
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax import cli
from spherejax.command_line.scene_numbers import number_at, with_number, with_text
from spherejax.files.fields.kinds import fields_of, is_needed, kinds_of, parameters_of
from spherejax.files.fields.quantities import QuantityField

STUDIED = "coupler_rocker"
SCENE = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall()))


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("rocker.mass=25 g", "bodies.rocker.mass", 0.025),
        ("friction.v1=1e-4", "joints.coupler_rocker.model.friction.v1", 1e-4),
        ("v1 = 0.1 mm/s", "joints.coupler_rocker.model.friction.v1", 1e-4),
        ("model.clearance=0.05mm", "joints.coupler_rocker.model.clearance", 5e-5),
        ("gravity=0, 0, -1.62", "gravity", (0.0, 0.0, -1.62)),
        ("gravity.z=-162 cm/s^2", "gravity", (0.0, 0.0, -1.62)),
        ("rocker.inertia.0=10 g mm^2", "bodies.rocker.inertia.x", 1e-8),
        ("gravity=[0,0,-162 cm/s^2]", "gravity", (0.0, 0.0, -1.62)),
        ("bodies.rocker.inertia=10 g mm^2,2e-5,3e-5", "rocker.inertia", (1e-8, 2e-5, 3e-5)),
        ("socket_material.youngs_modulus=70 GPa", "model.socket_material.youngs_modulus", 70e9),
        # Not given in the law, which takes it from radii and materials; its unit follows from the exponent.
        ("normal.stiffness=1e4 N/mm^1.5", "joints.coupler_rocker.model.normal.stiffness", 1e4 * 1e3**1.5),
    ],
)
def test_a_number_is_set_in_its_unit(text, path, value):
    changed = with_text(SCENE, text, STUDIED)
    np.testing.assert_allclose(number_at(changed, path, STUDIED), value, rtol=1e-14)
    others = [p for p in ("rocker.mass", "friction.v1", "clearance", "gravity") if p not in path]
    for other in others:
        np.testing.assert_array_equal(number_at(changed, other, STUDIED), number_at(SCENE, other, STUDIED))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rockr.mass=1", "no body 'rockr', and nothing of that name in the model of coupler_rocker; did you"),
        ("friction.v2=1", "joints.coupler_rocker.model.friction has no 'v2'"),
        ("joints.elbow.model=1", "joints has no 'elbow'"),
        ("clearance=1 kg", "a length [m] is expected"),
        ("clearance=0,1", "2 given; clearance is one number"),
        ("normal.stiffness=1e9 N/m", "[N/m^1.5] is expected"),
        ("friction=3", "friction is no number but a Threlfall; it has mu, v1"),
        ("gravity=1", "1 given; gravity is 3 numbers"),
        ("gravity.w=1", "its entries are x, y, z"),
        ("rocker.mass.x=1", "bodies.rocker.mass is a number by itself"),
        ("normal.stiffness.x=1", "is not given"),
        ("clearance", "write PATH=VALUE"),
        ("clearance=much", "'much'"),
    ],
)  # fmt: skip
def test_what_cannot_be_set_is_told(text, words):
    with pytest.raises(sj.SceneError) as error:
        with_text(SCENE, text, STUDIED)
    assert str(error.value).startswith(f"--set {text.partition('=')[0]}")
    assert words in str(error.value)


def laws_with_numbers():
    for family, argument in ((sj.laws.AbstractNormalLaw, "normal"), (sj.laws.AbstractFrictionLaw, "friction")):
        for kind, cls in kinds_of(family).items():
            if getattr(cls, "simulable", True):
                yield pytest.param(cls, argument, id=kind)


@pytest.mark.parametrize(("cls", "argument"), laws_with_numbers())
def test_every_number_of_every_law_is_reached(cls, argument):
    law = cls(**{name: 0.5 for name, parameter in parameters_of(cls).items() if is_needed(parameter)})
    scene = sj.gallery.four_bar(sj.Dry(1e-4, **{argument: law}))
    names = [name for name, field in fields_of(cls).items() if isinstance(field, QuantityField)]
    assert names
    for name in names:
        changed = with_text(scene, f"{argument}.{name}=0.125", STUDIED)
        assert getattr(getattr(changed.joints[STUDIED].model, argument), name) == 0.125


def test_another_shape_is_refused():
    with pytest.raises(sj.SceneError, match="gravity is numbers of shape"):
        with_number(SCENE, "gravity", 1.0)


def test_entries_of_one_array_may_be_traced():
    """As a fit of two of them does."""

    @jax.jit
    def inertia(x, y):
        return number_at(
            with_number(with_number(SCENE, "rocker.inertia.x", x), "rocker.inertia.y", y), "rocker.inertia"
        )

    own = np.asarray(SCENE.bodies["rocker"].inertia)
    np.testing.assert_array_equal(inertia(1e-5, 2e-5), [1e-5, 2e-5, own[2]])


def test_a_run_moves_as_its_numbers_say(tmp_path):
    words = [
        "run",
        "four-bar",
        "--joint",
        "friction",
        "--t1",
        "0.02",
        "--samples",
        "5",
        "--out",
        str(tmp_path / "a.nc"),
    ]
    assert cli.main([*words, "--set", "rocker.mass=60 g", "--set", "friction.mu=0.3"]) == 0
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(mu=0.3)))
    expected = sj.simulate(with_number(scene, "rocker.mass", 0.06), np.linspace(0.0, 0.02, 5), rtol=1e-8)
    with xarray.open_dataset(tmp_path / "a.nc") as run:
        np.testing.assert_allclose(run.position.sel(body="rocker"), expected.position("rocker"), rtol=0, atol=1e-12)


def test_the_scene_still_judges_the_number(capsys):
    assert cli.main(["run", "four-bar", "--joint", "friction", "--set", "friction.v1=-1", "--t1", "0.01"]) == 2
    said = capsys.readouterr().err
    assert "v1" in said
    assert "positive" in said


@pytest.mark.slow
def test_paths_are_varied_and_derived_by(tmp_path, capsys):
    out = tmp_path / "swept.nc"
    words = ["four-bar", "--joint", "friction", "--t1", "0.02"]
    vary = ["--vary", "friction.v1=1e-3:1e-2:2:log", "--vary", "rocker.mass=0.03:0.04:2", "--samples", "5"]
    assert cli.main(["sweep", *words, *vary, "--out", str(out), "--no-pictures"]) == 0
    with xarray.open_dataset(out) as swept:
        assert dict(swept["status"].sizes) == {"friction_v1": 2, "rocker_mass": 2}
        assert not swept["status"].any()
    assert cli.main(["sweep", *words, "--vary", "friction.v9=1:2:2", "--out", str(tmp_path / "b.nc")]) == 2
    assert "--vary friction.v9: joints.coupler_rocker.model.friction has no 'v9'" in capsys.readouterr().err
    by = ["--by", "friction.v1", "--of", "position.rocker.z", "--samples", "3"]
    assert cli.main(["sensitivity", *words, *by]) == 0
    assert "friction.v1" in capsys.readouterr().out.replace("friction_v1", "friction.v1")
    assert cli.main(["sensitivity", *words, "--by", "rocker.inertia", "--of", "position.rocker.z"]) == 2
    assert "--by rocker.inertia: it is numbers of shape (3,)" in capsys.readouterr().err
