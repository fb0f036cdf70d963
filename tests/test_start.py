"""Starts: velocities that the joints do not allow are removed with a warning, or kept where that is asked for."""

import inspect
import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start import assembly
from spherejax.motion.start.start_now import start_now
from spherejax.physics.state import unpack

Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
SIX = sj.laws.MatrixElastomer.cylindrical(
    np.array(Z),
    radial_stiffness=4e3,
    axial_stiffness=3e3,
    conical_stiffness=80.0,
    torsional_stiffness=40.0,
    damping=0.0,
)
HINGE = sj.laws.HingeElastomer.symmetric(radial_stiffness=4e3, axial_stiffness=3e3, damping=0.0, conical_stiffness=80.0)
CROSS = sj.laws.CrossElastomer(4e3 * np.eye(3), 0.0 * np.eye(3), 80.0)
SLIDING = sj.laws.HingeElastomer.symmetric(
    radial_stiffness=4e3, axial_stiffness=0.0, damping=0.0, conical_stiffness=80.0
)
MODELS = {
    "dry": sj.Dry(1e-4),
    "friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "lubricated": sj.Lubricated(1e-4, 0.4),
    "bushing": sj.Bushing(1e5, 1e-3),
    "six components": sj.Bushing(law=SIX),
}


def thrown(model, velocity=(0.3, 0.0, 0.0), **options):
    """A ball that leaves its socket's center."""
    ball = sj.Body(0.2, (1e-5,) * 3, velocity=velocity, points={"center": (0.0, 0.0, 0.0)})
    joint = sj.Spherical("ground.socket", "ball.center", model, **options)
    return sj.Scene({"ball": ball}, {"joint": joint}, ground_points={"socket": (0.0, 0.0, 0.0)})


def swung(joint, velocity=(0.0, 0.0, 0.0)):
    """A body with a given spin about a point that its velocity does, or does not, agree with."""
    body = sj.Body(1.0, (1e-2,) * 3, (0.0, 0.0, -0.5), velocity=velocity, angular_velocity=Y)
    return sj.Scene({"bob": body}, {"pivot": joint})


def started(scene, t=0.0):
    """Velocities and angular velocities that a run begins with."""
    system = sj.equations.compile_scene(scene).system
    state = unpack(system.layout._replace(n_memory=0, n_work=0), start_now(system, np.array([t])).y)
    return np.asarray(state.velocity), np.asarray(state.angular_velocity)


@pytest.mark.parametrize("name", MODELS)
def test_a_velocity_in_the_socket_is_removed_with_a_warning(name):
    message = (
        r"^joint 'joint' \(0\.3 m/s\).*concentric and at relative rest.*removed.*starts_concentric=False.*"
        r"Body 'ball' starts with \(0, 0, 0\) m/s .* instead of \(0\.3, 0, 0\) m/s"
    )
    with pytest.warns(sj.errors.StartWarning, match=message):
        velocity, _ = started(thrown(MODELS[name]))
    assert np.abs(velocity).max() < 1e-12


def two_arms(spin):
    """An arm on a hinge that is described as turning, and one on it, by a dry joint, that is described at rest."""
    bodies = {
        "upper": sj.Body.rod(
            {"top": (0, 0, 0), "end": (0.2, 0, 0)}, radius=0.01, mass=1.0, angular_velocity=(0, spin, 0)
        ),
        "lower": sj.Body.rod({"top": (0.2, 0, 0), "end": (0.2, 0, -0.3)}, radius=0.01, mass=1.0),
    }
    joints = {
        "hinge": sj.Revolute(("ground", "upper"), (0, 0, 0), (0, 1, 0)),
        "elbow": sj.Spherical("upper.end", "lower.top", sj.Dry(1e-4)),
    }
    return sj.Scene(bodies, joints)


def test_the_speed_that_gives_the_described_start_is_said():
    """The momentum of a body that is described alone in motion is shared; the projection is linear."""
    with pytest.warns(
        sj.errors.StartWarning, match="momentum of 'upper' was shared with them: described .* times as fast"
    ) as said:
        _, spins = started(two_arms(3.0))
    times = float(str(said[0].message).split("described ")[-1].split(" times")[0])
    assert times == pytest.approx(3.0 / spins[1, 1], rel=1e-3)
    with pytest.warns(sj.errors.StartWarning, match="elbow"):
        _, spins = started(two_arms(3.0 * times))
    assert spins[1, 1] == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_a_velocity_in_the_socket_is_kept_where_the_joint_starts_as_described(name):
    velocity, _ = started(thrown(MODELS[name], starts_concentric=False))
    assert velocity[0].tolist() == [0.3, 0.0, 0.0]


def test_a_run_says_so_where_it_is_called():
    with pytest.warns(sj.errors.StartWarning) as given:
        sj.simulate(thrown(sj.Ideal()), np.array([0.0]))
    assert given[0].filename == __file__


def test_a_velocity_that_an_ideal_joint_does_not_allow():
    message = (
        r"^joint 'pivot' \(0\.5 m/s\).*violate the constraint.*run\.velocity.*'bob' starts with \(-0\.01923, 0, 0\)"
    )
    with pytest.warns(sj.errors.StartWarning, match=message):
        velocity, spin = started(swung(sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)))
    # The impulse at the pivot: I w0 = (I + m l^2) w.
    assert spin[0, 1] == pytest.approx(1e-2 / (1e-2 + 0.25), rel=1e-9)
    assert velocity[0, 0] == pytest.approx(-0.5 * spin[0, 1], rel=1e-9)


BUSHINGS = {
    "revolute": (lambda **o: sj.Revolute(("ground", "bob"), (0.0,) * 3, Y, sj.Bushing(law=HINGE), **o), r"0\.5 m/s\)"),
    "universal": (
        lambda **o: sj.Universal(("ground", "bob"), (0.0,) * 3, Y, Z, sj.Bushing(law=CROSS), **o),
        r"0\.5 m/s\)",
    ),
    "cylindrical": (
        lambda **o: sj.Cylindrical(("ground", "bob"), (0.0,) * 3, Z, sj.Bushing(law=SLIDING), **o),
        r"0\.5 m/s and 1 rad/s\)",
    ),
    "prismatic": (
        lambda **o: sj.Prismatic(("ground", "bob"), (0.0,) * 3, Y, sj.Bushing(law=SIX), **o),
        r"0\.5 m/s and 1 rad/s\)",
    ),
    "fixed": (
        lambda **o: sj.Fixed(("ground", "bob"), (0.0,) * 3, sj.Bushing(law=SIX), **o),
        r"0\.5 m/s and 1 rad/s\)",
    ),
}


@pytest.mark.parametrize("name", BUSHINGS)
def test_bushings_of_all_joints_can_start_as_described(name):
    joint, size = BUSHINGS[name]
    with pytest.warns(sj.errors.StartWarning, match=r"'pivot' \(" + size):
        started(swung(joint()))
    velocity, spin = started(swung(joint(starts_concentric=False)))
    assert (velocity[0].tolist(), spin[0].tolist()) == ([0.0, 0.0, 0.0], list(Y))


def test_what_agrees_to_the_digits_of_a_table_is_taken_without_a_word():
    pivot = sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)
    started(swung(pivot, velocity=(-0.5001, 0.0, 0.0)))
    with pytest.warns(sj.errors.StartWarning):
        started(swung(pivot, velocity=(-0.505, 0.0, 0.0)))


def test_a_driver_sets_in_motion_what_is_described_at_rest():
    body = sj.Body(1.0, (1e-2,) * 3, (0.0, 0.0, -0.5))
    pivot = sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)
    motor = sj.RotationDriver(("ground", "bob"), Y, sj.functions.Linear(2.0))
    velocity, spin = started(sj.Scene({"bob": body}, {"pivot": pivot, "motor": motor}))
    assert spin[0, 1] == pytest.approx(2.0, rel=1e-9)
    assert velocity[0, 0] == pytest.approx(-1.0, rel=1e-9)


@pytest.mark.parametrize("name", [n for n in sj.gallery.__all__ if inspect.isfunction(getattr(sj.gallery, n))])
def test_scenes_of_the_gallery_have_velocities_that_agree(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        started(getattr(sj.gallery, name)())


def test_a_known_start_is_looked_at_while_other_numbers_are_traced():
    seen = []

    @jax.jit
    def begun(clearance):
        with pytest.warns(sj.errors.StartWarning):
            seen.append(start_now(sj.equations.compile_scene(thrown(sj.Dry(clearance))).system, np.array([0.0])))
        return clearance

    begun(1e-4)
    assert np.abs(np.asarray(seen[0].y)).max() == 1.0


def test_a_start_that_is_closed_and_at_rest_is_only_looked_at(monkeypatch):
    """Of a large mechanism each program of the assembly takes as long to make as the right-hand side."""
    made = []

    def noted(function, *others, **how):
        made.append(function.__name__)
        return program_for(function, *others, **how)

    monkeypatch.setattr(assembly, "program_for", noted)
    # Numbers that no other test has: what was assembled before is kept.
    rod = sj.Body(0.1, (4e-5, 3.4e-4, 3.4e-4), (0.1234, 0.0, 0.0), points={"end": (-0.1234, 0.0, 0.0)})
    pivot = sj.Revolute(("ground", "rod"), point=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    resting = sj.Scene({"rod": rod}, {"pivot": pivot})
    start = sj.simulate(resting, np.array([0.0, 1e-3])).assembly
    assert set(made) == {"assembly_residuals", "_described"}
    assert start.residual_after == start.residual_before == 0
    made.clear()
    turning = eqx.tree_at(lambda scene: scene.bodies["rod"].angular_velocity, resting, np.array([0.3, 1.0, 0.0]))
    with pytest.warns(sj.errors.StartWarning, match="velocities"):
        velocity, spin = started(turning)
    assert set(made) == {"assembly_residuals", "_described", "consistent_velocities"}
    # The least change in the metric of masses keeps the moment of momentum about the pivot.
    rate = 3.4e-4 / (3.4e-4 + 0.1 * 0.1234**2)
    assert spin[0] == pytest.approx([0.0, rate, 0.0], abs=1e-12)
    assert velocity[0] == pytest.approx([0.0, 0.0, -0.1234 * rate], abs=1e-12)
