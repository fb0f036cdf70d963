"""Force elements at their kinks, the forces of a suspension, and bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from elements import answer, program, scene_with

import spherejax as sj

TIME = 0.7


# Kinks ---------------------------------------------------------------------------------------------------------------


def slopes_at(force: sj.forces.AbstractForce, y) -> dict:
    """Wrenches and their derivatives by the state."""
    of_state = answer(force)
    function = program(lambda t, y: (of_state(t, y), jax.jacfwd(lambda y: of_state(t, y)["wrenches"])(y)))
    value, slope = function(TIME, np.asarray(y))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((value, slope)))
    return {"value": value, "slope": slope}


def together(distance=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Both bodies in world axes, the second at a place, the first at rest at the origin."""
    turned = [1.0, 0.0, 0.0, 0.0]
    return np.concatenate([np.zeros(3), turned, distance, turned, np.zeros(6), velocity, np.zeros(3)])


CENTERS = ("first", "second")


def test_a_spring_without_free_length_is_smooth_where_its_ends_meet():
    found = slopes_at(sj.SpringDamper(CENTERS, 50.0), together())
    np.testing.assert_allclose(found["slope"]["second"].force[:, 7:10], -50.0 * np.eye(3), rtol=1e-12)
    np.testing.assert_array_equal(found["value"]["wrenches"]["second"].force, 0.0)


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0)])
def test_coinciding_ends_are_finite(velocity):
    spring = sj.SpringDamper(CENTERS, 50.0, 4.0, 0.3, spring=sj.functions.Linear(2.0), damper=jnp.tanh)
    slopes_at(spring, together(velocity=velocity))
    slopes_at(sj.forces.BumpStop(CENTERS, 0.1, 0.2, 1e3, 1.0, 0.01), together(velocity=velocity))


@pytest.mark.parametrize("onset", [0.0, 0.01])
def test_exactly_at_a_stop_nothing_acts(onset):
    for stop in (
        sj.forces.BumpStop(CENTERS, longest=0.5, stiffness=1e3, onset=onset),
        sj.forces.BumpStop(("ground", "second"), shortest=0.5, stiffness=1e3, onset=onset, direction=(0.0, 0.0, 1.0)),
        sj.forces.Tyre("second", 0.5, 1e3, onset=onset),
    ):
        found = slopes_at(stop, together((0.0, 0.0, 0.5), (0.0, 0.0, 1.0)))
        assert not np.any(found["value"]["wrenches"]["second"].force)
        assert not np.any(found["slope"]["second"].force)


def test_a_stop_never_holds():
    stop = sj.forces.BumpStop(CENTERS, longest=0.5, stiffness=1e3, damping=1e3, onset=0.001)
    assert slopes_at(stop, together((0.0, 0.0, 0.51), (0.0, 0.0, -1.0)))["value"]["parts"]["force"] == 0
    assert slopes_at(stop, together((0.0, 0.0, 0.51), (0.0, 0.0, 1.0)))["value"]["parts"]["force"] == pytest.approx(
        1009.5
    )


def test_onset_has_a_continuous_slope_and_energy():
    stop = sj.forces.BumpStop(CENTERS, longest=0.5, stiffness=1e3, onset=0.02)
    for depth in (0.0, 0.02):
        before, after = (slopes_at(stop, together((0.0, 0.0, 0.5 + depth + side))) for side in (-1e-9, 1e-9))
        for found in (lambda x: x["slope"]["second"].force[2, 9], lambda x: x["value"]["energy"]):
            assert found(before) == pytest.approx(found(after), rel=1e-6, abs=1e-4)


def test_shock_absorber_at_rest_and_beyond_its_transition():
    absorber = sj.forces.ShockAbsorber(CENTERS, sj.functions.Linear(100.0), sj.functions.Linear(300.0), transition=0.02)
    for rate, force in ((-0.5, -50.0), (-0.02, -2.0), (0.0, 0.0), (0.02, 6.0), (0.5, 150.0)):
        found = slopes_at(absorber, together((0.0, 0.0, 1.0), (0.0, 0.0, rate)))
        assert found["value"]["parts"]["force"] == pytest.approx(force, abs=1e-12)
    sharp = sj.forces.ShockAbsorber(CENTERS, sj.functions.Linear(100.0), sj.functions.Linear(300.0), transition=0.0)
    assert slopes_at(sharp, together((0.0, 0.0, 1.0)))["value"]["parts"]["force"] == 0


def test_twist_tilted_by_pi_is_finite():
    y = together()
    spring = sj.TorsionalSpring(("ground", "second"), (0.0, 0.0, 1.0), 5.0, 1.0)
    start = np.asarray(scene_with(spring).bodies["second"].quaternion)
    y[10:14] = [-start[1], start[0], -start[3], start[2]]  # half a turn about x since the start, times the start
    y[20:] = np.arange(6)
    slopes_at(spring, y)


def test_angle_is_continuous_within_a_full_turn_and_jumps_at_its_end():
    spring = sj.TorsionalSpring(("ground", "second"), (0.0, 0.0, 1.0), 5.0)
    w, x, y, z = np.asarray(scene_with(spring).bodies["second"].quaternion)
    for turned, angle in ((3.2, 3.2), (-3.2, -3.2), (6.28, 6.28), (6.29, 6.29 - 4 * np.pi)):
        c, s = np.cos(turned / 2), np.sin(turned / 2)
        state = together()
        state[10:14] = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]  # turned about z since the start
        assert slopes_at(spring, state)["value"]["parts"]["angle"] == pytest.approx(angle)


# The forces of a suspension ------------------------------------------------------------------------------------------


def test_leaf_spring_with_bump_stop():
    up = (0.0, 0.0, 1.0)
    leaf = sj.SpringDamper(("ground", "second"), 35900.0, free_length=-0.076, direction=up)
    stop = sj.forces.BumpStop(("ground", "second"), longest=0.145, stiffness=1e7, direction=up)
    for u in (-0.05, 0.0, 0.1, 0.145, 0.146):
        y = together((0.3, 0.2, u))
        force = sum(slopes_at(element, y)["value"]["wrenches"]["second"].force for element in (leaf, stop))
        expected = 35900 * (0.076 + u) + 1e7 * max(0.0, u - 0.145)
        np.testing.assert_allclose(force, [0.0, 0.0, -expected], rtol=1e-9)


def test_tyre_over_the_bump():
    tyre = sj.forces.Tyre(
        "second", 0.36325, 460e3, road=sj.functions.Bump(height=0.2, start=15.0, length=5.0), speed=5.0
    )
    at_time = program(answer(tyre))
    for t in (0.0, 3.2, 3.5, 4.5):
        found = at_time(t, together((0.0, -0.615, 0.5)))
        height = 0.1 * (1 - np.cos(2 * np.pi * (5 * t - 15) / 5)) if 3 < t < 4 else 0.0
        assert found["parts"]["road_height"] == pytest.approx(height, abs=1e-14)
        assert found["parts"]["load"] == pytest.approx(460e3 * max(0.0, 0.36325 - 0.5 + height), rel=1e-12)
        np.testing.assert_allclose(found["wrenches"]["second"].force, [0.0, 0.0, found["parts"]["load"]])


# Bad input -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (lambda: sj.SpringDamper(CENTERS, -1.0), "force 'element': stiffness = -1 must be finite and not negative"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, -2.0), "damping = -2"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, free_length=np.nan), "free_length"),
        (lambda: sj.SpringDamper(("first.ear", "second"), 1.0), "body 'first' has no point 'ear'; it has 'eye'"),
        (
            lambda: sj.SpringDamper(("ground.ear", "second"), 1.0),
            r"body 'ground' has no point 'ear'.*in ground_points=",
        ),
        (lambda: sj.SpringDamper(("first", "third.eye"), 1.0), "there is no body 'third'"),
        (lambda: sj.SpringDamper(("first", "first.eye"), 1.0), "must lie on two bodies"),
        (lambda: sj.SpringDamper("first", 1.0), "must name two points"),  # pyright: ignore[reportArgumentType]
        (lambda: sj.SpringDamper(CENTERS, 1.0, direction=(0.0, 0.0, 0.0)), "direction = .* must be a direction"),
        (lambda: sj.SpringDamper(CENTERS, 1.0, direction=(0.0, 1.0)), "three numbers"),
        (lambda: sj.forces.ShockAbsorber(CENTERS, jnp.sin, jnp.sin, transition=-1.0), "transition = -1"),
        (lambda: sj.forces.BumpStop(CENTERS, 0.2, 0.1, 1e3), "longest = 0.1 must be above shortest"),
        (
            lambda: sj.forces.BumpStop(CENTERS, 0.2, stiffness=1e3, damping=1.0),
            "onset = 0 must be positive with damping",
        ),
        (lambda: sj.TorsionalSpring(("first", "first"), (0, 0, 1), 1.0), "bodies = .* must be two bodies"),
        (lambda: sj.TorsionalSpring(CENTERS, (0, 0, 0), 1.0), "axis = .* must be a direction"),
        (lambda: sj.forces.Tyre("second", -0.3, 1e5), "radius = -0.3 must be positive"),
        (lambda: sj.forces.Tyre("ground", 0.3, 1e5), "must be on a moving body"),
        (lambda: sj.forces.Tyre("second", 0.3, 1e5, road=sj.functions.Bump(0.1, 0.0, 0.0)), "road.length = 0"),
        (lambda: sj.forces.Tyre("second", 0.3, 1e5, road=0.0), "road = 0.0 is no function"),  # pyright: ignore[reportArgumentType]
        (lambda: sj.AppliedWrench("second.ear"), "no point 'ear'"),
    ],
)
def test_bad_input_is_named(force, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.equations.compile_scene(scene_with(force()))


def test_missing_arguments_are_named():
    with pytest.raises(TypeError, match="shortest= or longest="):
        sj.forces.BumpStop(CENTERS, stiffness=1e3)
    with pytest.raises(TypeError, match="compression= and extension="):
        sj.forces.ShockAbsorber(CENTERS, None, jnp.sin)  # pyright: ignore[reportArgumentType]
