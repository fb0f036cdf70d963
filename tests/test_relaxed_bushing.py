"""Bushings with a relaxed orientation of their own: a start that is twisted, with the moment and the motion of that."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.motion.equations.quantities import value_at
from spherejax.motion.start.assembly import described_state

START, K, INERTIA = 0.3, 12.0, 0.02
STIFFNESS = np.diag([2e5, 2e5, 5e4])
TORSION = sj.laws.MatrixElastomer(STIFFNESS, np.zeros((3, 3)), np.diag([40.0, 40.0, K]), np.zeros((3, 3)))


def turned(angle):
    """A turn about z."""
    return jnp.stack([jnp.cos(angle / 2), jnp.zeros(()), jnp.zeros(()), jnp.sin(angle / 2)])


def held(angle):
    """A body on a torsion spring that is relaxed at an angle, and starts at another."""
    body = sj.Body(
        1.0, (0.03, 0.03, INERTIA), quaternion=sj.orientation(axis=(0, 0, 1), angle=START), points={"c": (0, 0, 0)}
    )
    model = sj.Bushing(law=TORSION, relaxed_quaternion=turned(angle))
    joint = sj.Spherical("ground.o", "body.c", model, starts_concentric=False)
    return sj.Scene({"body": body}, {"joint": joint}, gravity=(0, 0, 0), ground_points={"o": (0, 0, 0)})


@pytest.mark.slow
def test_a_twisted_start_oscillates_as_a_torsion_pendulum():
    """angle = relaxed + (start - relaxed) cos(t sqrt(K/I)), and the derivative of that by the relaxed angle."""
    ts, relaxed = np.linspace(0.0, 0.5, 26), -0.4
    found = sj.sensitivity(held, {"angle": relaxed}, ts, observables=["quaternion.body.z"], rtol=1e-10)
    (column,) = found.columns
    swing = np.cos(np.sqrt(K / INERTIA) * ts)
    angle = relaxed + (START - relaxed) * swing
    np.testing.assert_allclose(column.values.ravel(), np.sin(angle / 2), atol=1e-8)
    np.testing.assert_allclose(column.slopes.ravel(), np.cos(angle / 2) / 2 * (1 - swing), atol=1e-7)
    assert np.ptp(angle) > 1.2


# Two bodies that start turned by any angles.
FIRST, SECOND = Rotation.from_rotvec([0.2, -0.5, 0.9]), Rotation.from_rotvec([1.0, 0.1, -0.3])
TWIST = np.array([0.3, -0.6, 0.4])
PAIR, PLACE = ("first", "second"), (0.0, 0.0, 0.0)
JOINTS = {
    "spherical": lambda model: sj.Spherical("first.p", "second.p", model),
    "spherical, as placed": lambda model: sj.Spherical("first.p", "second.p", model, starts_concentric=False),
    "fixed": lambda model: sj.Fixed(PAIR, PLACE, model),
    "prismatic": lambda model: sj.Prismatic(PAIR, PLACE, (1.0, 2.0, 2.0), model),
}


def scene_of(kind, relaxed):
    """The two bodies, joined with the same stiffness against all rotations."""
    along = np.diag([1e5, 1e5, 0.0 if kind == "prismatic" else 1e5])
    law = sj.laws.MatrixElastomer(along, np.zeros((3, 3)), K * np.eye(3), np.zeros((3, 3)))
    bodies = {
        name: sj.Body(1.0, (0.1, 0.1, 0.1), quaternion=turn, points={"p": PLACE})
        for name, turn in zip(PAIR, (FIRST, SECOND), strict=True)
    }
    return sj.Scene(bodies, {"joint": JOINTS[kind](sj.Bushing(law=law, relaxed_quaternion=relaxed))}, gravity=PLACE)


@jax.jit
def spins(system):
    y = described_state(system)
    return jnp.stack([value_at(system, 0.0, y, f"angular_acceleration.{name}") for name in PAIR])


@pytest.mark.parametrize("kind", JOINTS)
def test_the_moment_of_a_twist_acts_on_both_bodies(kind):
    """-K theta, theta from the relaxed orientation to that at the start, whatever the axes of bodies and joint."""
    relaxed = Rotation.from_rotvec(TWIST).inv() * FIRST.inv() * SECOND  # in the first body's axes theta is the twist
    moment = -K * FIRST.apply(TWIST)
    found = np.asarray(spins(sj.equations.compile_scene(scene_of(kind, relaxed)).system))
    np.testing.assert_allclose(found, [-moment / 0.1, moment / 0.1], rtol=1e-10)
    assert np.abs(spins(sj.equations.compile_scene(scene_of(kind, None)).system)).max() < 1e-10
    given = 1.0005 * sj.orientation(rotation=relaxed)  # printed tables carry four digits
    np.testing.assert_allclose(spins(sj.equations.compile_scene(scene_of(kind, given)).system), found, rtol=1e-12)


def test_the_moment_has_derivatives_by_the_relaxed_orientation():
    """Of a compiled system too, whose numbers are changed without the scene."""
    relaxed = sj.orientation(rotation=Rotation.from_rotvec(TWIST).inv() * FIRST.inv() * SECOND)
    system = sj.equations.compile_scene(scene_of("fixed", relaxed)).system

    def by(quaternion):
        leaf = lambda system: system.joints["joint"].model.relaxed_quaternion  # noqa: E731
        return spins(eqx.tree_at(leaf, system, quaternion))[1]

    slopes = np.asarray(jax.jacfwd(by)(jnp.asarray(relaxed)))
    steps = 1e-5 * np.eye(4)
    aside = np.stack([by(relaxed + h) - by(relaxed - h) for h in steps], 1) / 2e-5
    np.testing.assert_allclose(slopes, aside, rtol=1e-7, atol=1e-6)
    assert np.abs(slopes).max() > K / 0.1


def test_it_stands_in_scene_files(tmp_path):
    relaxed = FIRST.inv() * SECOND
    path = sj.save_scene(scene_of("fixed", relaxed), tmp_path / "twisted.toml")
    read = sj.load_scene(path).joints["joint"].model.relaxed_quaternion
    np.testing.assert_array_equal(read, sj.orientation(rotation=relaxed))


@pytest.mark.parametrize(
    ("law", "relaxed", "message"),
    [
        (TORSION, (1.0, 1.0, 0.0, 0.0), "relaxed_quaternion = .* must have unit norm.*Divide it by its norm"),
        (TORSION, (np.nan, 0.0, 0.0, 0.0), "relaxed_quaternion = .* must have unit norm"),
        (TORSION, (1.0, 0.0, 0.0), "relaxed_quaternion.*must be four numbers"),
        (
            sj.laws.VectorElastomer(1e5, 0.0),
            (1.0, 0.0, 0.0, 0.0),
            "relaxed_quaternion.*VectorElastomer leaves rotation free",
        ),
    ],
)
def test_what_is_no_orientation_is_refused(law, relaxed, message):
    model = sj.Bushing(law=law, relaxed_quaternion=relaxed)
    with pytest.raises(sj.SceneError, match=f"(?s)joint 'joint'.*{message}"):
        sj.equations.compile_scene(
            sj.Scene(
                {"body": sj.Body(1.0, (0.1, 0.1, 0.1), points={"p": PLACE})},
                {"joint": sj.Spherical("ground.o", "body.p", model)},
                ground_points={"o": PLACE},
            )
        )
