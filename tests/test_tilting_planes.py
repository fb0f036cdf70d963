"""Journals that tilt, with contact in planes along the axis and bearings that are not straight: closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.physics.joints.rim import MOST_PLANES, lobatto

C, R, L, STIFFNESS, MASS, AHEAD, GRAVITY = 2e-4, 1e-2, 0.04, 1e6, 0.5, 0.002, 9.81
TAPER = np.array([[1e-6, 2e-6, -1e-6], [4e-7, -8e-7, 5e-7], [3e-7, 4e-7, -2e-7]])
"""Depth that changes along the axis by less than the bearing yields under the shaft's weight."""
START = (0.6, 0.8, 0.0, 0.0)


def dry(stiffness=STIFFNESS, **options):
    law = sj.laws.HuntCrossleyDissipation(dissipation=300.0, stiffness=stiffness, exponent=1.0)
    return sj.Dry(C, socket_radius=R, normal=law, **options)


def shaft(model, ahead=AHEAD, **options):
    """A shaft along x, whose weight acts a little before its bearing's middle."""
    body = sj.Body(MASS, (1e-4, 2e-4, 2e-4), (ahead, 0, 0), quaternion=START)
    rims = sj.joints.tilting_journal("shaft", ("ground", "rotor"), (0, 0, 0), (1, 0, 0), model, length=L, **options)
    return sj.Scene({"rotor": body}, rims)


def at_rest(scene, planes):
    run = sj.simulate(scene, np.array([0.0, 0.25]), rtol=1e-9, atol=1e-12, throw=True)
    assert np.abs(run.velocity("rotor")[-1]).max() < 1e-7
    names = [f"shaft_{i + 1}" for i in range(planes)]
    heights = np.array([run.eccentricity(name)[-1, 2] for name in names])
    return heights, np.array([run.reaction(name)[-1, 2] for name in names])


def test_the_planes_are_those_of_lobattos_rule():
    for n in range(2, MOST_PLANES + 1):
        places, weights = lobatto(n)
        np.testing.assert_allclose(places, -places[::-1], atol=0)
        for degree in range(2 * n - 2):
            mean = 1 / (degree + 1) if degree % 2 == 0 else 0.0
            assert weights @ places**degree == pytest.approx(mean, abs=1e-14)
    np.testing.assert_array_equal(np.stack(lobatto(2)), [[-1.0, 1.0], [0.5, 0.5]])


def test_a_depth_along_the_axis_is_that_of_legendres_polynomials():
    depth = sj.laws.LegendreFourierDepth(TAPER)
    for s in (-1.0, -0.3, 0.0, 0.8, 1.0):
        expected = TAPER[0] + s * TAPER[1] + (1.5 * s * s - 0.5) * TAPER[2]
        np.testing.assert_allclose(depth.at(s).coefficients, expected, rtol=1e-14)
    places, weights = lobatto(3)
    there = [depth.at(s) for s in places]
    np.testing.assert_allclose(sj.laws.LegendreFourierDepth.through(places, there).coefficients, TAPER, atol=1e-20)
    # The planes' shares hold the volume: it is the mean of the first row.
    assert weights @ [d.coefficients[0] for d in there] == pytest.approx(TAPER[0, 0], rel=1e-14)


def test_a_depth_that_is_the_same_along_the_axis_is_that_of_its_planes():
    along = shaft(dry(), planes=3, socket_depth=sj.laws.LegendreFourierDepth(TAPER[:1]))
    each = shaft(dry(socket_depth=sj.laws.FourierDepth(TAPER[0])), planes=3)
    ours, other = jax.tree.leaves(along), jax.tree.leaves(each)
    assert len(ours) == len(other)
    for a, b in zip(ours, other, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("planes", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_a_shaft_rests_on_a_bearing_that_is_not_straight_as_by_hand(planes):
    """Springs all along the axis: W = K <d>, W a = K L/2 <s d>, with d(s) = p_0 + p_1 s - h(s) deep everywhere."""
    depth = sj.laws.LegendreFourierDepth(TAPER * [1, 1, 0])  # alike on both sides, so that nothing swings
    heights, forces = at_rest(shaft(dry(), planes=planes, socket_depth=depth), planes)
    # About x the joint's x axis is the world's z: the shaft lies at phi = pi.
    below = TAPER @ np.array([1.0, -1.0, 0.0])
    weight = MASS * GRAVITY
    first = weight / STIFFNESS
    second = 3 * weight * AHEAD / (STIFFNESS * L / 2)
    s, share = lobatto(planes)
    pressed = first + second * s - below[2] * (1.5 * s * s - 0.5)
    assert pressed.min() > 0.2 * first
    lowest = C + below[0] + first + (below[1] + second) * s
    np.testing.assert_allclose(-heights - C, lowest - C, rtol=1e-4)
    np.testing.assert_allclose(forces, STIFFNESS * share * pressed, rtol=2e-3)


def test_two_rims_tilt_a_third_as_far():
    """Springs at the ends resist a tilt with K L^2/4, springs all along with K L^2/12."""
    two, three = (at_rest(shaft(dry(), planes=n), n)[0] for n in (2, 3))
    assert (three[-1] - three[0]) / (two[-1] - two[0]) == pytest.approx(3.0, rel=1e-3)


@pytest.mark.slow
def test_derivatives_by_every_coefficient_are_those_of_differences():
    ts = np.array([0.0, 0.02])

    def end(coefficients, clearance, length):
        law = sj.laws.HuntCrossleyDissipation(dissipation=300.0, stiffness=1e6, exponent=1.0)
        model = sj.Dry(clearance, socket_radius=R, normal=law, friction=sj.Threlfall(0.1))
        depth = sj.laws.LegendreFourierDepth(coefficients)
        body = sj.Body(MASS, (1e-4, 2e-4, 2e-4), (AHEAD, 0, 0), angular_velocity=(30.0, 0, 0))
        rims = sj.joints.tilting_journal(
            "shaft", ("ground", "rotor"), (0, 0, 0), (1, 0, 0), model, length=length, planes=3, socket_depth=depth
        )
        run = sj.simulate(sj.Scene({"rotor": body}, rims), ts, rtol=1e-11, atol=1e-15)
        return jnp.concatenate([run.position("rotor")[-1, 1:] / C, run.velocity("rotor")[-1]])

    numbers = jnp.asarray(TAPER), jnp.asarray(C), jnp.asarray(L)
    forward = jax.jacfwd(end, argnums=(0, 1, 2))(*numbers)
    reverse = jax.grad(lambda *x: end(*x) @ jnp.arange(1.0, 6.0), argnums=(0, 1, 2))(*numbers)
    for part, step in enumerate((1e-9, 1e-9, 1e-6)):
        for index in np.ndindex(np.shape(numbers[part])):

            def moved(sign, part=part, index=index, step=step):
                changed = list(numbers)
                changed[part] = numbers[part].at[index].add(sign * step)
                return np.asarray(end(*changed))

            difference = (moved(1) - moved(-1)) / (2 * step)
            ours = np.asarray(forward[part])[(slice(None), *index)]
            np.testing.assert_allclose(ours, difference, atol=1e-4 * np.abs(difference).max())
            total = float(ours @ np.arange(1.0, 6.0))
            assert float(np.asarray(reverse[part])[index]) == pytest.approx(total, rel=1e-6)


def test_a_shaft_in_planes_goes_through_a_file(tmp_path):
    scene = shaft(dry(), planes=3, socket_depth=sj.laws.LegendreFourierDepth(TAPER))
    sj.save_scene(scene, tmp_path / "shaft.toml")
    back = sj.load_scene(tmp_path / "shaft.toml")
    for name, rim in scene.joints.items():
        read = back.joints[name]
        np.testing.assert_array_equal(read.model.socket_depth.coefficients, rim.model.socket_depth.coefficients)
        np.testing.assert_array_equal(read.point, rim.point)
        assert read.model.normal.stiffness == rim.model.normal.stiffness


OIL = sj.Lubricated(1e-4, 0.4, film=sj.laws.ShortBearing(0.02), conformity=sj.laws.JohnsonCylinder(0.02))
DEPTH = sj.laws.LegendreFourierDepth(TAPER)


@pytest.mark.parametrize(
    ("model", "options", "words"),
    [
        (dry(), {"planes": 1}, "planes = 1 must be a whole number from 2"),
        (dry(), {"planes": 10}, "to 9"),
        (dry(), {"planes": 2.0}, "planes = 2.0 must be a whole number"),
        (None, {"planes": 3}, "held by its two rims.*leave planes= out"),
        (None, {"socket_depth": DEPTH}, "its model is Ideal. Give Dry"),
        (OIL, {"socket_depth": DEPTH}, "Lubricated. Give Dry.*film in a bearing that is not straight"),
        (dry(), {"socket_depth": sj.laws.FourierDepth([1e-6])}, "is FourierDepth.*LegendreFourierDepth"),
        (
            dry(socket_depth=sj.laws.FourierDepth([1e-6])),
            {"socket_depth": DEPTH},
            "has a socket_depth, too; give the depth once",
        ),
        (dry(), {"socket_depth": sj.laws.LegendreFourierDepth([1e-6, 0.0])}, "be a table with a row for each"),
        (dry(), {"socket_depth": sj.laws.LegendreFourierDepth([[1e-6, 0.0]])}, "1, 3, 5, ... numbers"),
        (dry(), {"socket_depth": sj.laws.LegendreFourierDepth([[np.nan]])}, "be finite"),
        (dry(), {"planes": 3, "socket_depth": sj.laws.LegendreFourierDepth([[0.0], [3e-4]])}, "positive everywhere"),
    ],
)
def test_what_a_tilting_journal_cannot_have_is_refused(model, options, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.simulate(shaft(model, **options), np.array([0.0, 0.01]))


def test_a_depth_along_the_axis_is_none_of_a_parallel_journal():
    model = dry(socket_depth=DEPTH)
    body = sj.Body(MASS, (1e-4, 2e-4, 2e-4))
    scene = sj.Scene({"rotor": body}, {"pin": sj.Revolute(("ground", "rotor"), (0, 0, 0), (1, 0, 0), model)})
    with pytest.raises(sj.SceneError, match=r"model.socket_depth = LegendreFourierDepth.*must be a depth"):
        sj.simulate(scene, np.array([0.0, 0.01]))
