"""Scene files: what is written is read again to the last bit, and every public class can stand in one."""

import copy
import dataclasses
import inspect
import re
import tomllib
from functools import partial
from pathlib import Path

import cases
import double_pendulum
import equinox as eqx
import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest
import tomlkit
from double_pendulum import TEXT, write
from public import every_name
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.files.fields.dimensions import FIELDS
from spherejax.files.fields.kinds import keys_of, kinds_of, parameters_of
from spherejax.files.fields.objects import same
from spherejax.files.fields.parts import Either, PartField
from spherejax.files.fields.quantities import QuantityField
from spherejax.foundations.parts import kebab
from spherejax.foundations.units.units import in_si, simplified


@pytest.fixture
def written(tmp_path):
    """Writes a text to a scene file, with replacements."""
    return partial(write, tmp_path)


def test_a_file_gives_the_scene_that_python_gives(written):
    file = sj.files.read_scene_file(written())
    for one, other in zip(jax.tree.leaves(file.scene), jax.tree.leaves(double_pendulum.scene()), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15, atol=1e-17)
    assert jax.tree.structure(file.scene) == jax.tree.structure(double_pendulum.scene())
    assert (file.title, file.studied) == ("double pendulum with a dry elbow", "elbow")
    assert file.settings == sj.files.SimulationSettings(t1=0.04, samples=5, rtol=1e-6, solver="dopri8")


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
    assert same(scene.drift, sj.solvers.Baumgarte(alpha=2.0))


@pytest.mark.parametrize("kind", ["lugre", "lu-gre", "LuGre"])
def test_kinds_are_compared_without_hyphens_and_case(written, kind):
    scene = sj.load_scene(written(TEXT, ('{ kind = "threlfall", mu = 0.1 }', f'"{kind}"')))
    assert same(scene.joints["elbow"].model.friction, sj.LuGre())


def test_the_unit_of_a_stiffness_follows_its_exponent(written):
    law = '{ kind = "hertz", exponent = 2, stiffness = "3 kN/mm^2" }'
    scene = sj.load_scene(written(TEXT, ('{ kind = "lankarani-nikravesh", restitution = 0.9 }', law)))
    assert scene.joints["elbow"].model.normal.stiffness == pytest.approx(3e9, rel=1e-15)


UNITS_BY_TIME = {
    "constant": {"value": "N"},
    "linear": {"slope": "N/s", "offset": "N"},
    "polynomial": {"center": "s"},
    "power-tail": {"value": "N", "start": "s", "power": ""},
    "sine": {"amplitude": "N", "frequency": "Hz", "phase": "rad", "offset": "N"},
    "step": {"at": "s", "before": "N", "after": "N"},
    "smooth-step": {"start": "s", "end": "s", "before": "N", "after": "N"},
    "bump": {"height": "N", "start": "s", "length": "s"},
    "table": {"x": "s", "y": "N"},
    "smooth-table": {"x": "s", "y": "N"},
    "piecewise": {"breaks": "s"},
    "integral": {"start": "N", "origin": "s", "until": "s"},
    "sum": {},
    "random-road": {
        **{"roughness": "m^3", "lowest": "1/m", "highest": "1/m", "phases": "rad"},
        **dict.fromkeys(("seed", "waviness", "n_waves", "places"), ""),
    },
}
"""Of a force by time; a road is one by distance always."""


def test_units_of_functions_follow_their_argument_and_value():
    assert set(UNITS_BY_TIME) == set(kinds_of(sj.functions.AbstractFunction))
    for kind, cls in kinds_of(sj.functions.AbstractFunction).items():
        fields = {name: field for name, field in FIELDS[cls].items() if isinstance(field, QuantityField)}
        assert set(fields) == set(UNITS_BY_TIME[kind])
        for name, field in fields.items():
            si = simplified(field.si.format(of_argument="s", of_value="N"))
            unit = UNITS_BY_TIME[kind][name]
            assert simplified(si) == "1" if not unit else in_si(f"1 {unit}", si) == 1.0, (kind, name)


def test_functions_have_the_units_of_the_place_where_they_stand(written):
    force = """
[forces.shock]
kind = "spring-damper"
ends = ["ground.hook", "lower"]
spring = { kind = "polynomial", coefficients = ["1 kN", "2 N/mm", "3 N/mm^2"], center = "1 cm" }
[forces.shock.damper]
kind = "table"
x = { values = [-100, 0, 100], unit = "cm/s" }
y = ["-1 kN", 0, "1 kN"]
[forces.twist]
kind = "torsional-spring"
bodies = ["ground", "upper"]
axis = [0, 1, 0]
spring = { kind = "linear", slope = "1 N m/deg" }
[joints.motor]
kind = "rotation-driver"
bodies = ["ground", "upper"]
axis = [0, 1, 0]
angle = { kind = "linear", slope = "60 rpm", offset = "1 deg" }
[joints.slide]
kind = "distance-driver"
first = "ground.hook"
second = "lower.top"
length = { kind = "sine", amplitude = "1 cm", frequency = "2 Hz", phase = "90 deg", offset = 0.3 }
"""
    scene = sj.load_scene(written(TEXT + force))
    shock, twist = scene.forces["shock"], scene.forces["twist"]
    np.testing.assert_allclose(shock.spring.coefficients, [1e3, 2e3, 3e6], rtol=1e-14)
    assert shock.spring.center == pytest.approx(0.01)
    np.testing.assert_allclose(shock.damper.x, [-1.0, 0.0, 1.0], rtol=1e-14)
    np.testing.assert_allclose(shock.damper.y, [-1e3, 0.0, 1e3], rtol=1e-14)
    assert twist.spring.slope == pytest.approx(180 / np.pi)
    motor, slide = scene.joints["motor"].angle, scene.joints["slide"].length
    np.testing.assert_allclose([motor.slope, motor.offset], [2 * np.pi, np.pi / 180])
    np.testing.assert_allclose([slide.amplitude, slide.frequency, slide.phase, slide.offset], [0.01, 2, np.pi / 2, 0.3])


def round_trip(scene: sj.Scene, folder: Path) -> sj.Scene:
    return sj.load_scene(sj.save_scene(scene, folder / "written.toml"), allow_code=True)


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


@pytest.mark.parametrize("name", [name for name in sj.gallery.__all__])
def test_a_written_file_has_no_argument_that_is_a_default(name, tmp_path):
    scene = getattr(sj.gallery, name)()
    tables = tomllib.loads(sj.save_scene(scene, tmp_path / "written.toml").read_text())
    assert ("drift" in tables) != same(scene.drift, sj.solvers.PostStabilization())
    for group, parts in (("bodies", scene.bodies), ("joints", scene.joints), ("forces", scene.forces)):
        for part, made in parts.items():
            check_said(tables[group][part], made, f"{group}.{part}")


def check_said(table, made, where):
    """That no key of a table, and of the tables in it, has its default's value."""
    for key, parameter in parameters_of(type(made)).items():
        if key in table:
            value = getattr(made, key)
            assert not same(value, parameter.default), f"{where}.{key}"
            if isinstance(table[key], dict) and dataclasses.is_dataclass(value):
                check_said(table[key], value, f"{where}.{key}")


@pytest.mark.slow  # reads each file as often as it has keys
@pytest.mark.parametrize("name", [name for name in sj.gallery.__all__])
def test_no_line_of_a_written_file_says_a_default(name, tmp_path):
    scene = getattr(sj.gallery, name)()
    path = sj.save_scene(scene, tmp_path / "written.toml")
    tables = tomllib.loads(path.read_text())
    for place in places_in(tables):
        fewer = copy.deepcopy(tables)
        inner = fewer
        for key in place[:-1]:
            inner = inner[key]
        del inner[place[-1]]
        path.write_text(tomlkit.dumps(fewer))
        try:
            again = sj.load_scene(path)
        except sj.SceneError:
            continue  # it must be said
        assert not same(again, scene), f"{'.'.join(map(str, place))} says a default"


def places_in(table, above=()):
    """The keys of all tables in a table, and of the tables in its lists."""
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        if isinstance(table, dict):
            yield (*above, key)
        if isinstance(value, dict | list):
            yield from places_in(value, (*above, key))


def test_a_file_says_what_differs_from_the_defaults(tmp_path):
    model = sj.Ideal(passes=5, friction=sj.Threlfall(mu=0.2), radius=0.01)
    plain = sj.gallery.four_bar(model, drift=sj.solvers.Baumgarte(alpha=2.0))
    scene = sj.Scene(
        plain.bodies,
        {**plain.joints, "crank_pivot": eqx.tree_at(lambda j: j.model, plain.joints["crank_pivot"], model)},
        gravity=(0.0, 0.0, -1.62),
        drift=plain.drift,
    )
    text = sj.save_scene(scene, tmp_path / "s.toml").read_text()
    for line in ("gravity = [0.0, 0.0, -1.62] # m/s^2", "alpha = 2.0 # 1/s", "passes = 5", "mu = 0.2"):
        assert f"\n{line}\n" in text
    assert "beta" not in text
    assert "v1" not in text


@pytest.mark.parametrize(
    "drift",
    [
        sj.solvers.Baumgarte(1 / 3, 7.0),
        sj.solvers.NoDriftControl(),
        sj.solvers.PostStabilization(),
        sj.solvers.Projection(),
    ],
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
    # From another folder: by the module's name, for programs that have imported it.
    assert '"my_laws:Magnet"' in (tmp_path / "written.toml").read_text()


def test_what_is_written_names_units_and_keeps_title_studied_joint_and_settings(tmp_path):
    settings = sj.files.SimulationSettings(t1=0.5, dt=1e-3, rtol=1e-7, solver="rodas5p")
    scene = sj.gallery.four_bar(sj.Lubricated(1e-4, viscosity=0.3, boundary=sj.laws.Sommerfeld()))
    path = sj.save_scene(scene, tmp_path / "s.toml", title="four", studied="coupler_rocker", settings=settings)
    text = path.read_text()
    for line in ("mass = 0.0196 # kg", "viscosity = 0.3 # Pa s", "t1 = 0.5 # s", 'boundary = "sommerfeld"'):
        assert f"\n{line}\n" in text
    file = sj.files.read_scene_file(path)
    assert (file.title, file.studied, file.settings) == ("four", "coupler_rocker", settings)


@pytest.mark.parametrize(
    ("accuracy", "line"),
    [
        ("1 um", 'accuracy = "1 um"'),
        (1e-6, "accuracy = 1e-06 # m"),
        ({"position.rocker": "1 um", "reaction.coupler_rocker": 0.1}, 'accuracy = {"position.rocker" = "1 um",'),
    ],
)
def test_the_accuracy_of_a_run_is_written_and_read(tmp_path, accuracy, line):
    settings = sj.files.SimulationSettings(t1=0.5, solver="dopri8", accuracy=accuracy)
    path = sj.save_scene(sj.gallery.four_bar(sj.Dry(1e-4)), tmp_path / "s.toml", settings=settings)
    assert f"\n{line}" in path.read_text()
    assert sj.files.read_scene_file(path).settings == settings


def test_an_accuracy_that_cannot_be_is_not_written(tmp_path):
    with pytest.raises(sj.SceneError, match=r"simulation.accuracy: '1 N' is a force \[N\]"):
        sj.save_scene(sj.gallery.four_bar(), tmp_path / "s.toml", settings=sj.files.SimulationSettings(accuracy="1 N"))
    assert not (tmp_path / "s.toml").exists()


def test_a_stiffness_is_written_with_the_unit_of_its_exponent(tmp_path):
    scene = sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Hertz(stiffness=1e9, exponent=1.25)))
    path = sj.save_scene(scene, tmp_path / "s.toml")
    assert "stiffness = 1000000000.0 # N/m^1.25\n" in path.read_text()


def in_a_function() -> sj.forces.AbstractForce:
    class Hidden(my_laws.Magnet):
        pass

    return Hidden("crank", 1.0)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (
            sj.AppliedWrench("crank", force=lambda t: jnp.stack([t, t, t])),
            "the Python function <lambda> cannot be named in a file; put the Python function at the top of a file of "
            "its own, and import it from there",
        ),
        (
            sj.SpringDamper(("crank", "ground.pin"), spring=lambda u: u**3),
            "force 'f' cannot be written: the Python function <lambda> cannot be named in a file",
        ),
        (my_laws.Renamed(1.0), "keep each argument of its constructor in an attribute of the same name"),
        (in_a_function(), "put the class at the top of a file of its own"),
    ],
)
def test_what_no_file_can_hold_is_refused_with_a_remedy(force, message, tmp_path):
    scene = sj.gallery.four_bar()
    scene = sj.Scene(scene.bodies, scene.joints, {"f": force}, ground_points={"pin": (0.0, 0.0, 0.0)})
    with pytest.raises(sj.SceneError, match=re.escape(message)):
        sj.save_scene(scene, tmp_path / "s.toml")
    assert not list(tmp_path.iterdir())


def test_traced_and_batched_numbers_are_refused(tmp_path):
    def save(c):
        sj.save_scene(sj.gallery.four_bar(sj.Dry(c)), tmp_path / "s.toml")
        return c

    with pytest.raises(sj.SceneError, match="traced"):
        jax.jit(save)(1e-4)
    with pytest.raises(sj.SceneError, match=r"model.clearance = .* must be one number"):
        save(jnp.array([1e-4, 2e-4]))
    assert not list(tmp_path.iterdir())


def test_a_scene_that_cannot_be_simulated_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(sj.SceneError, match=r"^body 'b': mass = -1 must be positive"):
        sj.save_scene(sj.Scene({"b": sj.Body(-1.0, (1.0, 1.0, 1.0))}), tmp_path / "s.toml")
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
    family for family in every_name().values() if inspect.isclass(family) and family.__name__.startswith("Abstract")
)
NO_FAMILY = (sj.Body, sj.Material, sj.laws.Maxwell, sj.laws.Berg)
NO_KIND = {sj.functions.UserFunction: "holds a user's own function, which a file names instead"}
PUBLIC = [
    cls
    for cls in every_name().values()
    if inspect.isclass(cls)
    and not inspect.isabstract(cls)
    and not cls.__name__.startswith("Abstract")
    and (issubclass(cls, FAMILIES) or cls in NO_FAMILY)
    and cls not in NO_KIND
]


@pytest.mark.parametrize("cls", PUBLIC, ids=lambda cls: cls.__name__)
def test_every_public_class_can_stand_in_a_file_with_all_its_arguments(cls):
    assert cls in FIELDS
    assert set(FIELDS[cls]) == set(parameters_of(cls))


def test_the_table_has_public_classes_only():
    assert set(FIELDS) == set(PUBLIC)


AXIS = (0.0, 0.1, 1.0)
HINGE = sj.Bushing(law=sj.laws.HingeElastomer(1e6 * np.eye(3), 1e3 * np.eye(3), 5.0, 0.1, 0.2))
CROSS = sj.Bushing(law=sj.laws.CrossElastomer(1e6 * np.eye(3), 1e3 * np.eye(3), 5.0, 0.1))
BOTH = ("ground", "a")

JOINTS = [
    sj.Revolute(BOTH, "a.tip", AXIS),
    sj.Revolute(BOTH, (1.0, 2.0, 3.0), AXIS, HINGE),
    sj.Revolute(BOTH, "a.tip", AXIS, sj.Ideal(sj.BrownMcPhee(), 0.01, sj.laws.PointContact(), length=0.1, passes=5)),
    sj.Spherical("ground.hook", "a.tip", sj.Lubricated(1e-4, thickening=sj.laws.RoelandsThickening(0.7, 2e8))),
    sj.Spherical(
        "ground.hook",
        "a.tip",
        sj.Lubricated(
            1e-4, film=sj.laws.LinedSocket(sj.laws.WinklerLiner(1e9, 0.4, 8e-3), 1.2, (0.0, 0.6, 0.8), 5, 10)
        ),
    ),
    sj.Revolute(
        BOTH,
        "a.tip",
        AXIS,
        sj.Lubricated(
            1e-4,
            film=sj.laws.LinedBearing(0.01, sj.laws.WinklerLiner(1e9, 0.4, 2e-3), 48, 2, 0.3, 0.1, axial=2),
            conformity=sj.laws.JohnsonCylinder(0.01),
        ),
    ),
    sj.joints.Rim(BOTH, "ground.hook", AXIS),
    sj.joints.Rim(
        BOTH, (1.0, 2.0, 3.0), AXIS, sj.Dry(1e-4, conformity=sj.laws.EsduCylinder(0.01)), False, is_thrust=True
    ),
    sj.Cylindrical(BOTH, "ground.hook", AXIS),
    sj.Prismatic(BOTH, (1.0, 2.0, 3.0), AXIS),
    sj.Prismatic(BOTH, "a.tip", AXIS, sj.Ideal(sj.LuGre(), pressure=sj.laws.PreloadAlone(), preload_force=2.0)),
    sj.Universal(BOTH, "a.tip", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), CROSS),
    sj.Fixed(BOTH, "a.tip"),
    sj.joints.PointOnPlane("a.tip", (0.0, 0.0, 0.0), AXIS),
    sj.joints.PointOnPlane("b.tip", "ground.hook", AXIS, body="a"),
    sj.joints.SameOrientation(BOTH, "a.tip"),
    sj.joints.ParallelAxes(BOTH, (1.0, 2.0, 3.0), AXIS),
    sj.joints.PerpendicularAxes(BOTH, "ground.hook", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    sj.joints.PointOnCurve("a.tip", sj.joints.Circle((0.0, 0.0, 0.0), AXIS, 1.0)),
    sj.joints.PointOnCurve("b.tip", sj.joints.Line((0.0, 0.0, 0.0), AXIS), body="a"),
    sj.joints.PointOnCurve("a.tip", sj.joints.ImplicitCurve(my_laws.helix)),
    sj.joints.Distance("ground.hook", "a.tip"),
    sj.joints.Distance("ground.hook", "a.tip", 0.7),
    sj.joints.DistanceDriver("ground.hook", "a.tip", sj.functions.Sine(0.1, 2.0, 0.3, 1.0)),
    sj.RotationDriver(BOTH, AXIS, sj.functions.Linear(3.0, 0.1)),
    sj.RotationDriver(BOTH, AXIS, my_laws.hat),
    sj.TranslationDriver(BOTH, "a.tip", AXIS, sj.functions.SmoothStep(0.0, 1.0, 0.0, 0.2)),
    sj.TranslationDriver(BOTH, "a.tip", AXIS, rate=sj.functions.Table([0.0, 1.0], [0.0, 0.5]), start=0.1),
    sj.joints.PositionDriver("a.tip", my_laws.gust),
]

FUNCTIONS = [
    sj.functions.Constant(2.0),
    sj.functions.Linear(2.0, 0.1),
    sj.functions.Polynomial([1.0, 2.0, 3.0], center=0.1),
    sj.functions.Sine(1.0, 2.0, 0.3, 0.4),
    sj.functions.Step(0.1, 1.0, 2.0),
    sj.functions.SmoothStep(0.1, 0.2, 1.0, 2.0),
    sj.functions.Bump(0.1, 1.0, 2.0),
    sj.functions.Table([0.0, 1.0, 3.0], [0.0, 5.0, 6.0]),
    sj.functions.SmoothTable([0.0, 1.0, 3.0], [0.0, 5.0, 6.0]),
    sj.functions.Piecewise(
        [0.0],
        [
            sj.functions.Linear(1.0),
            sj.functions.Sum(sj.functions.Constant(0.5), sj.functions.Polynomial([0.0, 3.0]), my_laws.Growth(2.0)),
        ],
    ),
    sj.functions.Sum(),
    sj.functions.Integral(my_laws.Growth(2.0), 0.1, until=3.0, panels=8),
    my_laws.hat,
    my_laws.Growth(2.0),
]

FORCES = [
    *(sj.SpringDamper(("ground.hook", "a.tip"), 1e3, 1.0, 0.1, spring=one, damper=one) for one in FUNCTIONS),
    sj.SpringDamper(("a", "b.tip"), law=my_laws.Growth(3.0), direction=AXIS),
    sj.forces.ShockAbsorber(
        ("ground.hook", "a"), sj.functions.Linear(1e3), sj.functions.Linear(2e3), spring=sj.functions.Linear(10.0)
    ),
    sj.forces.BumpStop(("ground.hook", "a"), shortest=0.1, longest=0.5, stiffness=1e5, damping=10.0, onset=1e-3),
    sj.forces.BumpStop(("ground.hook", "a"), longest=0.5, spring=sj.functions.Polynomial([0.0, 0.0, 1e6])),
    sj.TorsionalSpring(BOTH, AXIS, 3.0, 0.1, 0.2, spring=sj.functions.Linear(2.0), damper=sj.functions.Linear(0.1)),
    sj.forces.BumpStop(("ground.hook", "a"), longest=0.5, stiffness=1e5, restitution=0.7, transition=0.02),
    sj.forces.TorsionalStop(
        BOTH, AXIS, -0.3, 7.0, 1e3, 2.0, 1e-3, spring=sj.functions.Linear(2.0), damper=sj.functions.Linear(0.1)
    ),
    sj.forces.TorsionalStop(BOTH, AXIS, largest=7.0, stiffness=1e3, restitution=0.7, transition=0.02),
    sj.forces.Coupler(sj.Turn(BOTH, AXIS, 0.2), sj.Travel(("ground.hook", "a.tip"), AXIS), -0.5, 1e3, 2.0, 0.01),
    sj.forces.Gear(
        sj.Turn(BOTH, AXIS), sj.Travel(("ground.hook", "a.tip"), AXIS), 0.1, 1e-3, 1e3, 2.0, 1e-4, efficiency=0.9
    ),
    sj.forces.Gear(
        sj.Turn(BOTH, AXIS),
        sj.Turn(BOTH, AXIS),
        -0.5,
        1e-3,
        1e3,
        restitution=0.7,
        transition=0.02,
        profile=sj.functions.Sine(0.1, 1.0, offset=1.0),
        pitch=0.3,
        loss_rate=0.02,
    ),
    sj.forces.Tyre(
        "a.tip", 0.3, 1e5, 10.0, 1e-3, road=sj.functions.Bump(0.1, 1.0, 2.0), speed=5.0, normal_to_road=True
    ),
    sj.forces.Tyre("a", 0.3, 1e5, road=my_laws.Growth(0.1)),
    my_laws.Motor("a", sj.functions.Sine(1.0, 2.0)),
    sj.AppliedWrench("a.tip", force=my_laws.gust, moment=(1.0, 2.0, 3.0), place=(0.1, 0.0, 0.0)),
    sj.forces.Tyre("a.tip", 0.3, 1e5, road=sj.functions.RandomRoad.of_class("C", seed=3, n_waves=5), speed=5.0),
    sj.Actuator(sj.Turn(BOTH, AXIS, 0.2), sj.functions.Sine(1.0, 2.0), 0.5),
    sj.forces.SampledActuator(sj.Extension(("ground.hook", "a.tip")), [0.0, 0.1, 0.3], [1.0, 2.0, 0.0]),
    sj.PID(
        sj.Turn(BOTH, AXIS),
        sj.functions.Sine(1.0, 2.0),
        10.0,
        20.0,
        0.1,
        filter_time=0.01,
        limits=(-1.0, 2.0),
        offset=0.1,
    ),
    sj.forces.SampledPID(sj.Extension(("ground.hook", "a.tip")), 0.01, 0.1, 10.0, 20.0, 0.1, limits=(-1.0, 2.0)),
]


def with_parts(joint: sj.joints.AbstractJoint | None = None, force: sj.forces.AbstractForce | None = None) -> sj.Scene:
    """A scene of two bodies with one joint of interest, or one force."""
    body = sj.Body(1.0, (1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0), points={"tip": (0.0, 0.0, 0.5)})
    joints = {} if joint is None else {"j": joint, "others": sj.Fixed(("a", "b"), (0.0, 0.0, 0.0))}
    forces = {} if force is None else {"f": force}
    return sj.Scene({"a": body, "b": body}, joints, forces, ground_points={"hook": (0.0, 0.0, 0.0)})


@pytest.mark.parametrize("joint", JOINTS, ids=lambda joint: type(joint).__name__)
def test_every_joint_comes_back_to_the_last_bit(joint, tmp_path):
    scene = with_parts(joint=joint)
    again = round_trip(scene, tmp_path)
    assert_equal_trees(again, scene)
    assert same(again, scene)


@pytest.mark.parametrize("force", FORCES, ids=lambda force: type(force).__name__)
def test_every_force_and_function_comes_back_to_the_last_bit(force, tmp_path):
    scene = with_parts(force=force)
    again = round_trip(scene, tmp_path)
    assert_equal_trees(again, scene)
    assert same(again, scene)


def classes_in(value) -> set[type]:
    """All classes in an object and what it is made of."""
    if dataclasses.is_dataclass(value):
        inside = [getattr(value, field.name) for field in dataclasses.fields(value)]
        return {type(value)}.union(*(classes_in(one) for one in inside))
    if isinstance(value, dict | tuple):
        return set().union(*(classes_in(one) for one in (value.values() if isinstance(value, dict) else value)))
    return set()


def test_every_class_of_the_table_has_been_through_a_round_trip():
    scenes = [case.build() for case in cases.CASES]
    seen = classes_in(
        (
            *scenes,
            *JOINTS,
            *FORCES,
            sj.solvers.NoDriftControl(),
            sj.solvers.PostStabilization(),
            sj.solvers.Projection(),
        )
    )
    never_simulated = {sj.Coulomb}
    assert set(FIELDS) - seen == never_simulated


UNITS_WRITTEN = {"N/m**n": "N/m^{exponent}", "-": "1"}


@pytest.mark.parametrize("cls", FIELDS, ids=lambda cls: cls.__name__)
def test_units_are_those_of_the_docstrings(cls):
    """A docstring is what people read, an annotation what files do."""
    doc = " ".join((cls.__doc__ or "").partition("Attributes:")[2].split())
    for name, field in FIELDS[cls].items():
        entry = re.search(rf"(?<![\w.]){name}: (.*?)(?= \w+: |$)", doc)
        unit = re.search(r"\[([^\]]+)\]", entry.group(1)) if entry else None
        if isinstance(field, PartField) and field.argument is not None and entry:
            value_by_argument = re.match(r"[^\[]*\[([^\]]+)\] by [^\[]*\[([^\]]+)\]", entry.group(1))
            assert not value_by_argument or value_by_argument.groups() == (field.value, field.argument), name
        field = field.quantity if isinstance(field, Either) else field
        depends_on_the_place = isinstance(field, QuantityField) and "{of_" in (field.si or "")
        if isinstance(field, QuantityField) and unit and not depends_on_the_place:
            assert (field.shown or field.si) == UNITS_WRITTEN.get(unit.group(1), unit.group(1)), name


@pytest.mark.parametrize("cls", FIELDS, ids=lambda cls: cls.__name__)
def test_every_key_has_its_words(cls):
    """For `spherejax list --kinds`: the docstring says what each argument is."""
    for key, what, meaning in keys_of(cls):
        assert what, key
        assert meaning, key
        assert "`" not in meaning


def test_words_of_keys_are_the_first_of_the_docstring():
    told = {key: meaning for key, _, meaning in keys_of(sj.Threlfall)}
    assert told == {"mu": "kinetic friction coefficient", "v1": "threshold velocity"}
    told = {key: meaning for key, _, meaning in keys_of(sj.Gonthier)}
    assert set(told) == {"restitution *", "stiffness", "exponent"}  # some from the class that it is derived from
    assert all(told.values())


@pytest.mark.parametrize(
    "family", [sj.laws.AbstractFrictionLaw, sj.laws.AbstractNormalLaw, sj.joints.AbstractSphericalModel]
)
def test_kinds_are_unique(family):
    names = [kebab(cls.__name__) for cls in FIELDS if issubclass(cls, family)]
    assert len(names) == len(set(names)) == len(kinds_of(family)) > 3
