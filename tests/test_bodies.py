"""Moments of inertia that no body has are refused, alone and in lanes; what is rounded, flat or thin is not."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import compile_scene
from spherejax.motion.equations.mobility import InverseMass
from spherejax.physics.bodies import (
    gyroscopic_moment,
    inertia_in_world,
    inertia_times,
    inverse_inertia,
    inverse_inertia_in_world,
)

SIDES = np.array([0.1, 0.2, 0.3])
BOX = np.diag(SIDES**2)  # [kg m^2], (0.01, 0.04, 0.09) break the triangle rule

NO_BODY = {
    "one moment": ((0.01,), "inertia = [0.01] must be three numbers or three rows of three numbers, not of shape (1,)"),
    "two moments": ((0.01, 0.02), "not of shape (2,). Write e.g. (1e-3, 1e-3, 1e-3) for the principal moments, or"),
    "a number": (0.01, "inertia = 0.01 must be three numbers or three rows of three numbers, not of shape ()"),
    "four rows": (np.eye(4), "must be three numbers or three rows of three numbers, not of shape (4, 4)"),
    "infinite": ((1.0, 1.0, np.inf), "must be finite numbers"),
    "NaN in a matrix": (np.diag([1.0, np.nan, 1.0]), "must be finite numbers"),
    "asymmetric": ([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "must be symmetric"),
    "the other sign": ([[1.0, 0.1, 0.0], [-0.1, 1.0, 0.0], [0.0, 0.0, 1.0]], "Products of inertia stand twice"),
    "too large a moment": ((1.0, 1.0, 2.1), "must obey the triangle rule: no principal moment is larger than the sum"),
    "a wrong unit": ((1e-4, 1e-4, 0.1), "Check that they are taken about the center of mass, and their units"),
    "squares of sides": (BOX, "must obey the triangle rule"),
    "large products": ([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]], "must obey the triangle rule"),
    "indefinite": ([[1.0, 1.5, 0.0], [1.5, 1.0, 0.0], [0.0, 0.0, 1.0]], "must be positive"),
}


def hanging(inertia):
    body = sj.Body(1.0, inertia, points={"top": (0.0, 0.0, 0.1)})
    return sj.Scene(
        {"bob": body}, {"pin": sj.Spherical("ground.hook", "bob.top")}, ground_points={"hook": (0.0, 0.0, 0.1)}
    )


@pytest.mark.parametrize("name", NO_BODY)
def test_what_no_body_has_is_refused(name):
    inertia, message = NO_BODY[name]
    with pytest.raises(sj.SceneError) as caught:
        compile_scene(hanging(inertia))
    assert str(caught.value).startswith("body 'bob': inertia = ")
    assert message in re.sub(r"\s+", " ", str(caught.value))


def rotation():
    a, b = np.cos(0.7), np.sin(0.7)
    return np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0, 0], [0, a, -b], [0, b, a]])


@pytest.mark.parametrize(
    "inertia",
    [
        (1.0, 1.0, 2.0),  # a flat disc, in which equality holds
        (1.004e-5, 1.004e-5, 2.01e-5),
        (1.00, 1.00, 2.01),  # the disc (1.004, 1.004, 2.008), printed with three digits
        (1e-9, 1.0, 1.0),  # a thin rod
        rotation() @ np.diag([1.0, 2.0, 3.0]) @ rotation().T,  # a flat plate in other axes, rounded
        (rotation() @ np.diag([1.0, 2.0, 2.5]) @ rotation().T).round(7),
    ],
)
def test_flat_thin_turned_and_rounded_bodies_are_bodies(inertia):
    assert compile_scene(hanging(inertia)).conditions == []


def test_lanes_that_are_no_body_say_so():
    """Moments, and matrices with one product of inertia or with two; a lane has the status of bad values."""
    one = np.zeros((3, 3))
    one[0, 1] = 1.0
    lanes = [
        (lambda z: jnp.stack([1.0, 1.0, z]), [1.0, 2.0, 2.1, -1.0, np.nan], [True, True, False, False, False]),
        (lambda z: np.eye(3) + z * one, [0.0, 0.1], [True, False]),
        (lambda z: np.eye(3) + z * (one + one.T), [0.1, 0.9, 1.5], [True, False, False]),
    ]
    for inertia, values, expected in lanes:

        def are_legal(z, inertia=inertia):
            return jnp.all(jnp.stack(compile_scene(hanging(inertia(z))).conditions))

        assert jax.vmap(are_legal)(jnp.array(values)).tolist() == expected

    def falling(moment):
        return sj.Scene({"bob": sj.Body(1.0, jnp.stack([1.0, 1.0, moment]))})

    runs = sj.simulate_many(falling, jnp.array([1.0, 2.1]), jnp.array([0.0, 0.01]), rtol=1e-4)
    assert runs.trajectories.status.tolist() == [sj.Status.SUCCEEDED, sj.Status.BAD_VALUE]


def test_a_robot_file_with_impossible_moments_is_refused(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        "<robot name='r'><link name='a'/><link name='b'><inertial><mass value='1'/>"
        "<inertia ixx='1' iyy='1' izz='3' ixy='0' ixz='0' iyz='0'/></inertial></link>"
        "<joint name='j' type='revolute'><parent link='a'/><child link='b'/><axis xyz='0 0 1'/></joint></robot>"
    )
    with pytest.raises(sj.SceneError, match=r"body 'b': inertia = .* must obey the triangle rule"):
        compile_scene(sj.load_urdf(path))


FULL = np.array([[0.03, 0.004, -0.002], [0.004, 0.04, 0.005], [-0.002, 0.005, 0.05]])


@pytest.mark.parametrize("inertia", [np.array([0.03, 0.04, 0.05]), FULL])
def test_inertia_by_way_of_the_body_is_that_of_the_world(inertia):
    """Times a vector, and its inverse, whatever the quaternion's norm; derivatives too."""
    vector, mass = jnp.array([0.4, -1.0, 0.7]), 2.0

    def both(quaternion):
        rotation = rotation_matrix(quaternion)
        own, world = inverse_inertia(jnp.asarray(inertia)), inertia_in_world(jnp.asarray(inertia), rotation)
        inverse = inverse_inertia_in_world(jnp.asarray(inertia), rotation)
        masses = InverseMass(jnp.array([1 / mass]), inverse[None], own[None], rotation[None])
        wrench = jnp.concatenate([vector, vector[::-1]])[None]
        inverted = jnp.concatenate([vector / mass, jnp.linalg.solve(world, vector[::-1])])
        times = inertia_times(jnp.asarray(inertia), rotation, vector)
        turning = gyroscopic_moment(jnp.asarray(inertia), rotation, vector)
        return (times, turning, masses.times(wrench)[0], masses.turned_times(wrench)[0]), (
            world @ vector, -jnp.cross(vector, world @ vector), inverted, inverted
        )  # fmt: skip

    for norm in (1.0, 1.1):
        quaternion = norm * jnp.array([0.5, -0.1, 0.7, np.sqrt(0.25)])
        (found, expected), (along, expected_along) = jax.jvp(both, (quaternion,), (jnp.array([0.3, 0.1, -0.2, 0.5]),))
        for one, other in ((found, expected), (along, expected_along)):
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13), one, other)
