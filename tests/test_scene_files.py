"""Scene files: what is written is read again to the last bit, and every public class can stand in one."""

import inspect
import re
from functools import partial
from pathlib import Path

import cases
import double_pendulum
import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest
from double_pendulum import TEXT, write
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.files.dimensions import FIELDS
from spherejax.files.fields import Quantity
from spherejax.files.kinds import kebab, kinds_of, parameters_of
from spherejax.files.objects import same


@pytest.fixture
def written(tmp_path):
    """Writes a text to a scene file, with replacements."""
    return partial(write, tmp_path)


def test_a_file_gives_the_scene_that_python_gives(written):
    file = sj.read_scene_file(written())
    for one, other in zip(jax.tree.leaves(file.scene), jax.tree.leaves(double_pendulum.scene()), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15, atol=1e-17)
    assert jax.tree.structure(file.scene) == jax.tree.structure(double_pendulum.scene())
    assert (file.title, file.studied) == ("double pendulum with a dry elbow", "elbow")
    assert file.settings == sj.SimulationSettings(t1=0.04, samples=5, rtol=1e-6, solver="dopri8")


@pytest.mark.parametrize(
    ("rotation", "expected"),
    [
        (
            '{ axis = [1, 2, 3], angle = "40 deg" }',
            Rotation.from_rotvec(np.deg2rad(40) * np.array([1, 2, 3]) / 14**0.5),
        ),
        ('{ sequence = "ZXZ", angles = ["10 deg", 0.2, 0.3] }', Rotation.from_euler("ZXZ", [np.deg2rad(10), 0.2, 0.3])),
        ('{ sequence = "xyz", angles = [0.1, 0.2, 0.3] }', Rotation.from_euler("xyz", [0.1, 0.2, 0.3])),
        ('{ sequence = "YX", angles = [0.1, 0.2] }', Rotation.from_euler("YX", [0.1, 0.2])),
        ('{ sequence = "y", angles = [0.7] }', Rotation.from_euler("y", 0.7)),
    ],
)
def test_rotations_mean_what_scipy_means(written, rotation, expected):
    path = written(TEXT, ('{ axis = [0, 1, 0], angle = "90 deg" }', rotation))
    quaternion = sj.load_scene(path).bodies["upper"].quaternion
    np.testing.assert_allclose(quaternion, expected.as_quat(scalar_first=True), atol=1e-15)


def test_all_of_a_scene_can_stand_in_a_file(written):
    more = """
[forces.push]
kind = "applied-wrench"
body = "lower"
force = ["1 kN", 0, 0]
in_body_axes = true
[drift]
kind = "baumgarte"
alpha = "2 1/s"
"""
    scene = sj.load_scene(written('gravity = [0, 0, "-1.62 m/s^2"]\n' + TEXT + more))
    np.testing.assert_array_equal(scene.gravity, [0, 0, -1.62])
    assert same(scene.forces["push"], sj.AppliedWrench("lower", (1000.0, 0.0, 0.0), in_body_axes=True))
    assert same(scene.drift, sj.Baumgarte(alpha=2.0))


@pytest.mark.parametrize("kind", ["lugre", "lu-gre", "LuGre"])
def test_kinds_are_compared_without_hyphens_and_case(written, kind):
    scene = sj.load_scene(written(TEXT, ('{ kind = "threlfall", mu = 0.1 }', f'"{kind}"')))
    assert same(scene.joints["elbow"].model.friction, sj.LuGre())


def test_the_unit_of_a_stiffness_follows_its_exponent(written):
    law = '{ kind = "hertz", exponent = 2, stiffness = "3 kN/mm^2" }'
    scene = sj.load_scene(written(TEXT, ('{ kind = "lankarani-nikravesh", restitution = 0.9 }', law)))
    assert scene.joints["elbow"].model.normal.stiffness == pytest.approx(3e9, rel=1e-15)


def round_trip(scene: sj.Scene, folder: Path) -> sj.Scene:
    return sj.load_scene(sj.save_scene(scene, folder / "written.toml"))


def assert_equal_trees(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


@pytest.mark.parametrize("case", cases.CASES, ids=lambda case: case.name)
def test_every_scene_of_the_tests_comes_back_to_the_last_bit(case, tmp_path):
    scene = case.build()
    assert_equal_trees(round_trip(scene, tmp_path), scene)


@pytest.mark.parametrize("name", [name for name in sj.gallery.__all__])
def test_every_scene_of_the_gallery_comes_back_to_the_last_bit(name, tmp_path):
    scene = getattr(sj.gallery, name)()
    assert_equal_trees(round_trip(scene, tmp_path), scene)


@pytest.mark.parametrize(
    "drift", [sj.Baumgarte(1 / 3, 7.0), sj.NoDriftControl(), sj.PostStabilization(), sj.Projection()]
)
def test_every_drift_control_comes_back(drift, tmp_path):
    scene = sj.gallery.four_bar(drift=drift)
    assert_equal_trees(round_trip(scene, tmp_path), scene)


@pytest.mark.parametrize(
    "number", [0.1 + 0.2, 1e-300, -5e-324, 1.7976931348623157e308, 1 / 3, 1e22, 123456789.123456789]
)
def test_numbers_come_back_to_the_last_bit(number, tmp_path):
    body = sj.Body(1.0, (1.0, 1.0, 1.0), position=(number, -number, 0.0))
    np.testing.assert_array_equal(round_trip(sj.Scene({"b": body}), tmp_path).bodies["b"].position, body.position)


@pytest.mark.parametrize("radius", [0.0099, 0.00999999, 0.01 - 1e-17, 0.003, 1e-9])
def test_a_ball_radius_comes_back_as_a_ball_radius(radius, tmp_path):
    if 0.01 - radius == 0:
        radius = 0.0098765
    scene = sj.gallery.four_bar(sj.Dry(ball_radius=radius))
    assert_equal_trees(round_trip(scene, tmp_path), scene)


def test_names_that_toml_must_quote_come_back(tmp_path):
    body = sj.Body(1.0, (1.0, 1.0, 1.0), points={"a b.c": (1.0, 2.0, 3.0), "π": (0.0, 0.0, 0.0), '"': (1.0, 1.0, 1.0)})
    scene = sj.Scene({"left arm": body}, gravity=(0.0, 0.0, 0.0))
    assert_equal_trees(round_trip(scene, tmp_path), scene)


def test_a_users_classes_are_named_by_their_file_and_come_back(tmp_path):
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=my_laws.Viscous(3.0)))
    scene = sj.Scene(scene.bodies, scene.joints, {"magnet": my_laws.Magnet("rocker", 2.0, is_on=False)})
    again = round_trip(scene, tmp_path)
    assert_equal_trees(again, scene)
    assert type(again.forces["magnet"]) is my_laws.Magnet
    assert 'my_laws.py:Magnet"' in (tmp_path / "written.toml").read_text()


def test_what_is_written_names_units_and_keeps_title_studied_joint_and_settings(tmp_path):
    settings = sj.SimulationSettings(t1=0.5, dt=1e-3, rtol=1e-7, solver="rodas5p")
    scene = sj.gallery.four_bar(sj.Lubricated(1e-4))
    path = sj.save_scene(scene, tmp_path / "s.toml", title="four", studied="coupler_rocker", settings=settings)
    text = path.read_text()
    for line in ("mass = 0.0196 # kg", "viscosity = 0.4 # Pa s", "t1 = 0.5 # s", 'boundary = "guembel"'):
        assert f"\n{line}\n" in text
    file = sj.read_scene_file(path)
    assert (file.title, file.studied, file.settings) == ("four", "coupler_rocker", settings)


def test_a_stiffness_is_written_with_the_unit_of_its_exponent(tmp_path):
    scene = sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Hertz(stiffness=1e9, exponent=1.25)))
    path = sj.save_scene(scene, tmp_path / "s.toml")
    assert "stiffness = 1000000000.0 # N/m^1.25\n" in path.read_text()


def force_by_time(t):
    return jnp.stack([t, 0.0 * t, 0.0 * t])


def in_a_function() -> sj.AbstractForce:
    class Hidden(my_laws.Magnet):
        pass

    return Hidden("crank", 1.0)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (
            sj.AppliedWrench("crank", force=force_by_time),
            "force 'f' cannot be written: AppliedWrench: a Python function",
        ),
        (my_laws.Renamed(1.0), "keep each argument of its constructor in an attribute of the same name"),
        (in_a_function(), "put the class at the top of a file of its own"),
    ],
)
def test_what_no_file_can_hold_is_refused_with_a_remedy(force, message, tmp_path):
    scene = sj.gallery.four_bar()
    with pytest.raises(sj.SceneError, match=re.escape(message)):
        sj.save_scene(sj.Scene(scene.bodies, scene.joints, {"f": force}), tmp_path / "s.toml")
    assert not list(tmp_path.iterdir())


def test_traced_and_batched_numbers_are_refused(tmp_path):
    def save(c):
        sj.save_scene(sj.gallery.four_bar(sj.Dry(c)), tmp_path / "s.toml")
        return c

    with pytest.raises(sj.SceneError, match="traced"):
        jax.jit(save)(1e-4)
    with pytest.raises(sj.SceneError, match=r"2 numbers; a length \[m\] is expected"):
        save(jnp.array([1e-4, 2e-4]))
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_replaced_only_on_request_and_never_by_a_failure(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("precious")
    with pytest.raises(sj.SceneError, match="exists"):
        sj.save_scene(sj.gallery.four_bar(), path)
    scene = sj.gallery.four_bar()
    with pytest.raises(sj.SceneError, match="attribute of the same name"):
        sj.save_scene(sj.Scene(scene.bodies, scene.joints, {"f": my_laws.Renamed(1.0)}), path, overwrite=True)
    assert path.read_text() == "precious"
    sj.save_scene(scene, path, overwrite=True)
    assert_equal_trees(sj.load_scene(path), scene)
    assert [one.name for one in tmp_path.iterdir()] == ["s.toml"]
    with pytest.raises(sj.SceneError, match=r"ending \.toml"):
        sj.save_scene(scene, tmp_path / "s.txt")
    with pytest.raises(sj.SceneError, match="cannot write"):
        sj.save_scene(scene, tmp_path / "nowhere" / "s.toml")


FAMILIES = tuple(
    family
    for family in (getattr(sj, name) for name in sj.__all__)
    if inspect.isclass(family) and family.__name__.startswith("Abstract")
)
PUBLIC = [
    cls
    for cls in (getattr(sj, name) for name in sj.__all__)
    if inspect.isclass(cls)
    and not inspect.isabstract(cls)
    and not cls.__name__.startswith("Abstract")
    and (issubclass(cls, FAMILIES) or cls in (sj.Body, sj.Material, sj.Spherical, sj.Revolute))
]
NO_PART_OF_A_SCENE: set[type] = set()


@pytest.mark.parametrize("cls", [cls for cls in PUBLIC if cls not in NO_PART_OF_A_SCENE], ids=lambda cls: cls.__name__)
def test_every_public_class_can_stand_in_a_file_with_all_its_arguments(cls):
    assert cls in FIELDS, f"add {cls.__name__} to spherejax/files/dimensions.py"
    assert set(FIELDS[cls]) == set(parameters_of(cls))


def test_the_table_knows_many_classes():
    assert {sj.Dry, sj.Revolute, sj.LuGre, sj.CurveElastomer, sj.AppliedWrench, sj.Projection} <= set(PUBLIC)


UNITS_WRITTEN = {"N/m**n": "N/m^{exponent}", "-": "1"}


@pytest.mark.parametrize("cls", FIELDS, ids=lambda cls: cls.__name__)
def test_units_are_those_of_the_docstrings(cls):
    """The docstring of a class was written by whoever wrote the law; the table by whoever wrote the files."""
    doc = " ".join((cls.__doc__ or "").partition("Attributes:")[2].split())
    for name, field in FIELDS[cls].items():
        entry = re.search(rf"(?<![\w.]){name}: (.*?)(?= \w+: |$)", doc)
        unit = re.search(r"\[([^\]]+)\]", entry.group(1)) if entry else None
        if isinstance(field, Quantity) and unit:
            assert field.si == UNITS_WRITTEN.get(unit.group(1), unit.group(1)), name


@pytest.mark.parametrize("family", [sj.AbstractFrictionLaw, sj.AbstractNormalLaw, sj.AbstractSphericalModel])
def test_kinds_are_unique(family):
    names = [kebab(cls.__name__) for cls in FIELDS if issubclass(cls, family)]
    assert len(names) == len(set(names)) == len(kinds_of(family)) > 3
