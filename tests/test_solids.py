"""Bodies by their shape: against integrals over the volume by the midpoint rule, not against the formulas again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix


def moments_of(inside, box, n=161):
    """Mass and moments per density of what is inside a box, by the midpoint rule."""
    axes = [np.linspace(-edge / 2, edge / 2, n + 1)[:-1] + edge / (2 * n) for edge in box]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    weight = inside(x, y, z) * np.prod(box) / n**3
    squares = np.array([x**2, y**2, z**2])
    return weight.sum(), np.array([(weight * (squares.sum(axis=0) - square)).sum() for square in squares])


SHAPES = {
    "box": (lambda: sj.Body.box((0.2, 0.1, 0.05), density=1000.0), lambda x, y, z: np.ones_like(x), (0.2, 0.1, 0.05)),
    "cylinder": (
        lambda: sj.Body.cylinder(0.03, 0.2, density=1000.0),
        lambda x, y, z: (y**2 + z**2 < 0.03**2).astype(float),
        (0.2, 0.06, 0.06),
    ),
    "cylinder along y": (
        lambda: sj.Body.cylinder(0.03, 0.2, axis="y", density=1000.0),
        lambda x, y, z: (x**2 + z**2 < 0.03**2).astype(float),
        (0.06, 0.2, 0.06),
    ),
    "cylinder along z": (
        lambda: sj.Body.cylinder(0.03, 0.2, axis="z", density=1000.0),
        lambda x, y, z: (x**2 + y**2 < 0.03**2).astype(float),
        (0.06, 0.06, 0.2),
    ),
    "sphere": (
        lambda: sj.Body.sphere(0.05, density=1000.0),
        lambda x, y, z: (x**2 + y**2 + z**2 < 0.05**2).astype(float),
        (0.1, 0.1, 0.1),
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_mass_and_moments_are_integrals_over_the_volume(shape):
    make, inside, box = SHAPES[shape]
    body = make()
    volume, moments = moments_of(inside, box)
    # The midpoint rule counts whole cells: a share of 1e-3 at a curved boundary, 1e-5 without one.
    np.testing.assert_allclose(body.mass, 1000.0 * volume, rtol=1e-3)
    np.testing.assert_allclose(body.inertia, 1000.0 * moments, rtol=1e-3)


def test_mass_stands_for_density():
    by_density = sj.Body.box((0.2, 0.1, 0.05), density=1000.0)
    by_mass = sj.Body.box((0.2, 0.1, 0.05), mass=1.0)
    np.testing.assert_allclose(by_density.inertia, by_mass.inertia, rtol=1e-14)
    assert by_density.mass == pytest.approx(1.0, rel=1e-14)


DIRECTIONS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 2, 3), (-1, -2, 3), (-1, 1e-9, 0), (0, 1e-9, -1)]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_rod_lies_between_its_ends(direction):
    first = np.array([0.3, -0.2, 0.1])
    second = first + 0.25 * np.array(direction) / np.linalg.norm(direction)
    rod = sj.Body.rod({"pin": first, "tip": second}, radius=4e-3, density=7850.0, points={"middle": (0.0, 0.0, 4e-3)})
    turn = np.asarray(rotation_matrix(jnp.asarray(rod.quaternion)))
    for name, place in (("pin", first), ("tip", second)):
        np.testing.assert_allclose(rod.position + turn @ rod.points[name], place, rtol=0, atol=1e-15)
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), rtol=0, atol=1e-15)
    assert rod.mass == pytest.approx(7850.0 * np.pi * 4e-3**2 * 0.25)
    assert list(rod.points) == ["pin", "tip", "middle"]
    same = sj.Body.cylinder(4e-3, 0.25, density=7850.0)
    np.testing.assert_allclose(rod.inertia, same.inertia, rtol=1e-14)


@pytest.mark.parametrize("axis", [(0, 0, 2), (1.0, -2.0, 2.0), np.array([0.3, 0.1, -0.7])])
def test_a_cylinder_about_any_axis_is_one_along_x_that_is_turned(axis):
    """By the rotation of SciPy that takes x to the axis; the axis is symmetric, so any such rotation will do."""
    straight, found = (sj.Body.cylinder(0.05, 0.3, axis=a, mass=2.0) for a in ("x", axis))
    n = np.asarray(axis) / np.linalg.norm(axis)
    turn = Rotation.align_vectors([n], [[1.0, 0.0, 0.0]])[0]
    R = turn.as_matrix()
    np.testing.assert_allclose(found.inertia, R @ np.diag(straight.inertia) @ R.T, atol=1e-15)
    traced = jax.jit(lambda a: sj.Body.cylinder(0.05, 0.3, axis=a, mass=2.0).inertia)(jnp.asarray(axis, float))
    np.testing.assert_allclose(traced, found.inertia, atol=1e-15)


def linkage(length, radius):
    """A rod that hangs from its pin and swings; its angle's frequency is known."""
    rod = sj.Body.rod({"pin": (0.0, 0.0, 0.0), "tip": (length, 0.0, 0.0)}, radius=radius, density=7850.0)
    return sj.Scene({"rod": rod}, {"hinge": sj.Revolute(("ground", "rod"), "rod.pin", (0.0, 1.0, 0.0))})


def test_a_rod_falls_as_it_must():
    length, radius = 0.4, 5e-3
    run = sj.simulate(linkage(length, radius), np.array([0.0, 1e-3]))
    about_pin = radius**2 / 4 + length**2 / 3  # per mass
    expected = -9.81 * (length / 2) / about_pin * (length / 2)
    assert run.acceleration("rod")[0, 2] == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_lengths_are_swept_and_derived_by():
    def depth(length):
        return sj.simulate(linkage(length, 5e-3), jnp.array([0.0, 0.1])).position("rod")[-1, 2]

    lengths = jnp.array([0.2, 0.4])
    swept = jax.vmap(depth)(lengths)
    for value, length in zip(swept, lengths, strict=True):
        assert value == pytest.approx(float(depth(float(length))), abs=1e-9)
    h = 1e-5
    differences = (depth(0.3 + h) - depth(0.3 - h)) / (2 * h)
    assert jax.grad(depth)(0.3) == pytest.approx(float(differences), rel=1e-5)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_derivatives_by_the_ends_are_finite(direction):
    def parts(end):
        rod = sj.Body.rod({"a": (0.0, 0.0, 0.0), "b": end}, radius=1e-2, density=1.0)
        return jnp.concatenate([rod.quaternion, rod.inertia, rod.position, jnp.atleast_1d(rod.mass)])

    assert np.isfinite(jax.jacfwd(parts)(jnp.array(direction))).all()
    assert np.isfinite(jax.jacrev(parts)(jnp.array(direction))).all()


ENDS = {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sj.Body.box((1.0, 1.0, 1.0)), "give mass= [kg] or density= [kg/m^3], not neither"),
        (lambda: sj.Body.sphere(1.0, mass=1.0, density=1.0), "not both"),
        (lambda: sj.Body.box(1.0, mass=1.0), "size must be three numbers"),
        (lambda: sj.Body.box((1.0, -1.0, 1.0), mass=1.0), "size"),
        (lambda: sj.Body.cylinder(0.0, 1.0, mass=1.0), "radius"),
        (lambda: sj.Body.cylinder(0.1, 1.0, axis="w", mass=1.0), "axis = 'w' must be 'x', 'y', 'z'"),
        (lambda: sj.Body.cylinder(0.1, 1.0, axis=(1, 0), mass=1.0), "axis = (1, 0) must be"),
        (lambda: sj.Body.cylinder(0.1, 1.0, axis=(0, 0, 0), mass=1.0), "has no direction"),
        (lambda: sj.Body.sphere("0.1 m", mass=1.0), "radius must be one number"),
        (lambda: sj.Body.sphere(0.1, mass="1 kg"), "mass must be one number"),
        (lambda: sj.Body.rod({"a": (0, 0, 0)}, radius=0.1, mass=1.0), "ends must be two places by name"),
        (lambda: sj.Body.rod({"a": (0, 0, 0), "b": (0, 0, 0)}, radius=0.1, mass=1.0), "'a' and 'b' coincide"),
        (lambda: sj.Body.rod([(0, 0, 0), (1, 0, 0)], radius=0.1, mass=1.0), "ends must be two places by name"),
        (lambda: sj.Body.rod(ENDS, radius=-0.1, mass=1.0), "radius"),
    ],
)
def test_what_is_no_solid_is_told(make, words):
    with pytest.raises(sj.SceneError) as error:
        make()
    assert words in str(error.value)


def test_a_traced_length_below_zero_fails_its_lane():
    def status(radius):
        body = sj.Body.sphere(radius, mass=1.0, points={"pin": (0.0, 0.0, 0.1)})
        joints = {"pin": sj.Spherical("ground.o", "ball.pin")}
        scene = sj.Scene({"ball": body}, joints, ground_points={"o": (0, 0, 0.1)})
        return sj.simulate(scene, jnp.array([0.0, 1e-3])).status

    found = jax.vmap(status)(jnp.array([0.05, -0.05]))
    assert found[0] == sj.Status.SUCCEEDED
    assert found[1] == sj.Status.BAD_VALUE
