"""What looks like a mistake in the start: motors on locked bodies, joints beside the point that was meant."""

import warnings

import jax
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import compile_scene
from spherejax.motion.start.doubts import doubts_of
from spherejax.motion.start.points_beside import points_beside
from spherejax.motion.start.start_now import known_start

TS = np.linspace(0.0, 0.02, 3)
Y = (0.0, 1.0, 0.0)


def slider_crank(axis=Y, drive=None, *, model=None, off=0.0, **wrist):
    """A slider-crank in the plane across y, whose wrist turns about some axis; its rod may be described elsewhere."""
    inertia = (0.01, 0.01, 0.01)
    crank = sj.Body(1.0, inertia, (0.05, 0.0, 0.05), points={"pin": (0.05, 0.0, 0.05)})
    ends = {"big": (-0.15, 0.0, 0.05), "small": (0.15, 0.0, -0.05)}
    rod = sj.Body(1.0, inertia, (0.25, 0.0, 0.05 + off), points=ends)
    slider = sj.Body(1.0, inertia, (0.4, 0.0, 0.0), points={"wrist": (0.0, 0.0, 0.0)})
    joints = {
        "main": sj.Revolute(("ground", "crank"), (0.0, 0.0, 0.0), Y),
        "big_end": sj.Revolute(("crank", "rod"), "crank.pin", Y, second_point="rod.big"),
        "wrist": sj.Revolute(("rod", "slider"), **({"point": "slider.wrist", "axis": axis, "model": model} | wrist)),
        "guide": sj.Prismatic(("ground", "slider"), (0.4, 0.0, 0.0), (1.0, 0.0, 0.0)),
    }
    forces = {}
    if isinstance(drive, sj.forces.AbstractForce):
        forces["drive"] = drive
    elif drive is not None:
        joints["drive"] = drive
    return sj.Scene({"crank": crank, "rod": rod, "slider": slider}, joints, forces)


TURN = sj.Turn(("ground", "crank"), Y)
MOTORS = {
    "actuator": sj.Actuator(TURN, 1.0),
    "sampled": sj.forces.SampledActuator(TURN, [0.0, 0.1], [1.0, 2.0]),
    "pid": sj.PID(TURN, reference=1.0, proportional=10.0, integral=1.0),
    "driver": sj.RotationDriver(("ground", "crank"), Y, sj.functions.SmoothStep(0.0, 0.1, 0.0, 1.0)),
}
SKEW = (0.0, 1.0, 0.01)


def doubts(scene):
    system = compile_scene(scene).system
    start = known_start(system, TS)
    assert start is not None
    return (*start.doubts, *points_beside(scene, system))


@pytest.mark.parametrize("motor", MOTORS)
def test_a_motor_on_locked_bodies_is_named_with_the_count(motor):
    """One axis of four is 0.6 degrees off: 20 equations hold all 18 velocities. Parallel axes leave one motion."""
    (said,) = doubts(slider_crank(SKEW, MOTORS[motor]))
    assert said.startswith(
        "motor 'drive' acts on bodies 'crank', 'rod', 'slider', which are locked: 0 degrees of freedom"
    )
    assert "20 constraint equations for the 18 velocities of 3 bodies" in said
    assert "'wrist' 5" in said
    assert doubts(slider_crank(Y, MOTORS[motor])) == ()


def test_drivers_are_looked_at_while_a_builder_is_traced():
    """`sj.sweep` looks at the start while it traces the builder; with a driver it died."""
    said = []

    def traced(mass):
        said.extend(doubts(slider_crank(SKEW, MOTORS["driver"])))
        return mass

    jax.eval_shape(traced, 1.0)
    assert len(said) == 1


def test_what_is_meant_to_stand_still_is_not_named():
    """A truss without motor, a brake, a bushing that gives way."""
    brake = sj.RotationDriver(("ground", "crank"), Y, sj.functions.Linear(0.0, 0.0))
    elastic = sj.Bushing(law=sj.laws.HingeElastomer(1e6 * np.eye(3), 1e3 * np.eye(3), 5.0, 0.1, 0.2))
    for scene in (
        slider_crank(SKEW),
        slider_crank(SKEW, brake),
        slider_crank(SKEW, MOTORS["pid"], model=elastic),
    ):
        assert doubts(scene) == ()


def test_groups_are_judged_one_by_one():
    """Two arms on the ground, one of them bolted down: only the motor of the latter moves nothing."""
    arms = {name: sj.Body(1.0, (0.01,) * 3, position=(0.1, y, 0.0)) for name, y in (("free", 0.0), ("held", 1.0))}
    joints = {
        "hinge": sj.Revolute(("ground", "free"), (0.0, 0.0, 0.0), Y),
        "bolt": sj.Fixed(("ground", "held"), (0.0, 1.0, 0.0)),
    }
    motors = {name: sj.Actuator(sj.Turn(("ground", name), Y), 1.0) for name in arms}
    (said,) = doubts(sj.Scene(arms, joints, motors))
    assert said.startswith("motor 'held' acts on body 'held', which is locked")


def test_a_dead_point_is_not_locked():
    """The rod stretched along the slider's way: the slider has no velocity there, the crank has."""
    crank = sj.Body(1.0, (0.01,) * 3, (0.05, 0.0, 0.0))
    rod = sj.Body(1.0, (0.01,) * 3, (0.25, 0.0, 0.0))
    slider = sj.Body(1.0, (0.01,) * 3, (0.4, 0.0, 0.0))
    joints = {
        "main": sj.Revolute(("ground", "crank"), (0.0, 0.0, 0.0), Y),
        "big_end": sj.Revolute(("crank", "rod"), (0.1, 0.0, 0.0), Y),
        "wrist": sj.Revolute(("rod", "slider"), (0.4, 0.0, 0.0), Y),
        "guide": sj.Prismatic(("ground", "slider"), (0.4, 0.0, 0.0), (1.0, 0.0, 0.0)),
    }
    push = sj.Actuator(sj.Travel(("ground", "slider"), (1.0, 0.0, 0.0)), 1.0)
    assert doubts(sj.Scene({"crank": crank, "rod": rod, "slider": slider}, joints, {"push": push})) == ()


def test_a_joint_beside_a_point_that_nothing_uses_is_named():
    """The rod is described 5 cm too high, the big end is closed by its second point; the wrist has one point alone."""
    (said,) = doubts(slider_crank(off=0.05))
    assert said.startswith("joint 'wrist' (Revolute) is 0.05 m beside point 'rod.small'")
    assert "give the joint point='rod.small' and second_point='slider.wrist'" in said
    # As described, used elsewhere, or said to be another place: no mistake.
    assert doubts(slider_crank()) == ()
    assert doubts(slider_crank(off=0.05, second_point="slider.wrist")) == ()
    spring = sj.SpringDamper(("rod.small", "slider.wrist"), 1.0)
    assert doubts(slider_crank(drive=spring, off=0.05)) == ()


ENTRANCES = {"simulate": lambda scene: sj.simulate(scene, TS), "start": sj.start, "ode": sj.ode}


@pytest.mark.parametrize("entrance", ["start", "ode"])
def test_whoever_starts_a_motion_hears_of_it(entrance):
    for scene, said in (
        (slider_crank(SKEW, MOTORS["actuator"]), "motor 'drive' acts on bodies"),
        (slider_crank(off=0.05), "beside point 'rod.small'"),
    ):
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            ENTRANCES[entrance](scene)
        assert any(said in str(warning.message) for warning in heard)


@pytest.mark.parametrize("entrance", ENTRANCES)
def test_what_is_no_scene_is_refused_in_words(entrance):
    with pytest.raises(sj.SceneError, match=r"a str is no scene: 'crank\.toml'.*sj\.load_scene"):
        ENTRANCES[entrance]("crank.toml")


@pytest.mark.parametrize("kind", ["universal", "fixed", "revolute"])
def test_a_second_point_is_closed_and_said(kind):
    """5 cm beside its place: with a second point the body is moved there, and the run says by how much."""
    bar = sj.Body(1.0, (0.1,) * 3, position=(0.5, 0.0, 0.05), points={"end": (-0.5, 0.0, 0.0)})
    between, hook = ("ground", "bar"), (0.0, 0.0, 0.0)
    made = {
        "universal": lambda **more: sj.Universal(between, hook, Y, (0.0, 0.0, 1.0), **more),
        "fixed": lambda **more: sj.Fixed(between, hook, **more),
        "revolute": lambda **more: sj.Revolute(between, hook, Y, **more),
    }[kind]
    scene = sj.Scene({"bar": bar}, {"joint": made(second_point="bar.end")})
    with pytest.warns(sj.errors.StartWarning, match=r"'bar' by 0\.0.* m .*'joint' gapes most there \(0\.05 m"):
        run = sj.simulate(scene, TS)
    turn = rotation_matrix(run.quaternion("bar")[0])
    assert np.allclose(run.position("bar")[0] + turn @ np.array([-0.5, 0.0, 0.0]), 0.0, atol=1e-9)
    # With one point the joint takes it on both bodies, 5 cm beside the end; only a run of joints that turn says so.
    expected = [] if kind == "fixed" else ["is 0.05 m beside point 'bar.end'"]
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        sj.simulate(sj.Scene({"bar": bar}, {"joint": made()}), TS)
    assert len(given) == len(expected)
    assert all(text in str(each.message) for text, each in zip(expected, given, strict=True))


def test_second_points_are_kept_in_scene_files(tmp_path):
    between = ("ground", "bar")
    joint = sj.Universal(between, (0.0, 0.0, 0.0), Y, (0.0, 0.0, 1.0), second_point="bar.end")
    bar = sj.Body(1.0, (0.1,) * 3, position=(0.5, 0.0, 0.0), points={"end": (-0.5, 0.0, 0.0)})
    sj.save_scene(sj.Scene({"bar": bar}, {"joint": joint}), tmp_path / "bar.toml")
    assert sj.load_scene(tmp_path / "bar.toml").joints["joint"].second_point_name == "bar.end"


def test_runs_of_a_sweep_say_how_many_are_locked():
    def build(skew):
        return slider_crank((0.0, 1.0, skew), MOTORS["actuator"])

    expected = r"^1 of 2 runs that were looked at look like a mistake; of run 1: motor 'drive' acts on bodies"
    with pytest.warns(sj.errors.StartWarning, match=expected):
        sj.simulate_many(build, {"skew": np.array([0.0, 0.01])}, TS, rtol=1e-4)


FILMS = {
    "full": sj.laws.FullFilm(),
    "radial": sj.laws.RadialFilm(),
    "short": sj.laws.ShortBearing(0.01),
    "long": sj.laws.LongBearing(0.04),
}


@pytest.mark.parametrize("name", FILMS)
def test_a_films_damping_is_that_of_its_action(name):
    axis = np.array([0.0, 0.0, 1.0]) if FILMS[name].is_of_bearing else None
    still, rate = np.zeros(3), np.array([0.0, 0.02, 0.0])
    motion = sj.laws.FilmMotion(still, rate, still, still, axis)
    force = FILMS[name].action(motion, sj.laws.FilmGap(1e-4, 0.01, 0.4, 0.0, sj.Guembel())).force
    assert -float(force[1]) / 0.02 == pytest.approx(FILMS[name].damping(1e-4, 0.01, 0.4), rel=1e-9)


def test_a_film_whose_reaction_is_rounding_is_said():
    def film(clearance):
        scene = sj.gallery.four_bar(sj.Lubricated(clearance, 0.4))
        return doubts_of(scene, compile_scene(scene).system)

    assert film(1e-4) == film(1e-6) == ()
    (said,) = film(1e-8)
    assert "rounding of velocities" in said
    assert "coupler_rocker" in said
