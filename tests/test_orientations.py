"""Orientations by axis and angle, by angles, by matrices and by SciPy's `Rotation`, against SciPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.physics.joints.body_axes import perpendicular


def same(quaternion, rotation: Rotation):
    expected = np.roll(rotation.as_quat(), 1)
    assert np.shape(quaternion) == (4,)
    found = np.asarray(quaternion)
    np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-14)


RANDOM = np.random.default_rng(5)


def test_an_axis_and_an_angle():
    for axis, angle in (((0, 0, 1), 0.3), ((1.0, -2.0, 0.5), 4.0), ((1e-9, 0, 0), -0.1)):
        same(
            sj.orientation(axis=axis, angle=angle), Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
        )


@pytest.mark.parametrize("sequence", ["ZXZ", "xyz", "Y", "zy", "XYZ", "zxz"])
def test_angles_one_after_the_other(sequence):
    angles = RANDOM.uniform(-3, 3, len(sequence))
    # SciPy before 1.15 makes a list of one rotation of a list of one angle.
    expected = Rotation.from_euler(sequence, angles if len(sequence) > 1 else angles[0])
    same(sj.orientation(sequence=sequence, angles=angles), expected)


def test_matrices_of_every_branch():
    turns = [Rotation.random(rng=i) for i in range(20)]
    turns += [Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)]  # half turns: the scalar entry is 0
    for rotation in turns:
        same(sj.orientation(matrix=rotation.as_matrix()), rotation)
        same(sj.orientation(rotation=rotation), rotation)
        for given in (rotation, rotation.as_matrix()):
            same(sj.Body(1.0, (1, 1, 1), quaternion=given).quaternion, rotation)


def test_known_numbers_stay_known_and_traced_ones_have_derivatives():
    assert isinstance(sj.orientation(sequence="zx", angles=(0.1, 0.2)), np.ndarray)
    zero, one = jnp.zeros(()), jnp.ones(())

    def matrix(a):
        s, c = jnp.sin(a), jnp.cos(a)
        return jnp.array([[one, zero, zero], [zero, c, -s], [zero, s, c]])

    for make in (
        lambda a: sj.orientation(axis=(0.3, 0.4, 0.1), angle=a),
        lambda a: sj.orientation(sequence="XY", angles=(a, 0.2)),
        lambda a: sj.orientation(sequence="z", angles=a),
        lambda a: sj.orientation(matrix=matrix(a)),
    ):
        slope = jax.jit(jax.jacfwd(make))(0.7)
        up, down = (np.asarray(make(jnp.asarray(a))) for a in (0.7 + 1e-6, 0.7 - 1e-6))
        np.testing.assert_allclose(slope, (up - down) / 2e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ({}, "stated in one way"),
        ({"axis": (0, 0, 1), "angle": 1.0, "matrix": np.eye(3)}, "stated in one way"),
        ({"axis": (0, 0, 1)}, "belong together"),
        ({"sequence": "ZXZ"}, "belong together"),
        ({"axis": (0, 0, 0), "angle": 1.0}, "must be a direction"),
        ({"axis": (0, 1), "angle": 1.0}, "three numbers"),
        ({"sequence": "ZZ", "angles": (0, 1)}, "no sequence of axes"),
        ({"sequence": "Zx", "angles": (0, 1)}, "no sequence of axes"),
        ({"sequence": "ZX", "angles": (0, 1, 2)}, "needs 2 angles"),
        ({"matrix": 2 * np.eye(3)}, "is no rotation"),
        ({"matrix": np.diag([1.0, 1.0, -1.0])}, "is no rotation"),
    ],
)
def test_what_is_no_orientation_says_what_to_write(form, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.orientation(**form)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), (1.0, 1.0, 0.0), (0.0, -1.0, 1.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("rounding", np.random.default_rng(3).normal(0.0, 1e-12, (4, 3)))
def test_the_direction_across_an_axis_does_not_hang_on_its_rounding(axis, rounding):
    """Grooves of a bearing and angles of a hinge without a second axis are counted from it."""
    axis = np.asarray(axis)
    across = perpendicular(axis)
    np.testing.assert_allclose(perpendicular(axis + rounding), across, rtol=0, atol=1e-11)
    np.testing.assert_allclose(perpendicular(jnp.asarray(axis + rounding)), across, rtol=0, atol=1e-11)
    np.testing.assert_allclose([across @ axis, across @ across], [0.0, 1.0], rtol=0, atol=1e-15)
