"""Stops about an axis: limits, backlash, restitution, against closed forms and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import spherejax as sj

Z = (0.0, 0.0, 1.0)
ENDS = ("ground", "w")
INERTIA, SPEED, STIFFNESS = 0.01, 10.0, 1e4


def wheel(*stop, speed=SPEED, forces=None, **more):
    """A wheel on a hinge between two stops, without weight."""
    body = sj.Body(1.0, (INERTIA,) * 3, angular_velocity=(0.0, 0.0, speed))
    hinge = {"hinge": sj.Revolute(ENDS, (0, 0, 0), Z)}
    forces = {"stop": sj.forces.TorsionalStop(ENDS, Z, *stop, **more), **(forces or {})}
    return sj.Scene({"w": body}, hinge, forces, gravity=(0, 0, 0))


def rates(run):
    return np.asarray(run.angular_velocity("w")[:, 2])


def left_over(e):
    """q in the module `one_sided`: v'^2 = e^2 v^2 + q w^2, by the energy of an impact."""
    h = (1 - e * e) / (1 + e * e)

    def integrand(u):
        s = u * (3 - u * u) / 2
        return u * (1 / (1 + h * s) - 1 / (1 + h) + 1 / (1 - h) - 1 / (1 - h * s))

    return 2 * (1 - h) * quad(integrand, 0, 1)[0]


def test_a_wheel_goes_to_and_fro_between_its_stops():
    """A free flight of b/v and half a period of the spring, in turn: the energy stays."""
    b = 0.8
    contact = np.pi * np.sqrt(INERTIA / STIFFNESS)
    period = 2 * (b / SPEED + contact)
    ts = np.append(np.linspace(0.0, 3.0 * period, 50), 3.37 * period)
    run = sj.simulate(wheel(-0.3, 0.5, STIFFNESS, restitution=1.0), ts, rtol=1e-10)
    np.testing.assert_allclose(run.mechanical_energy, 0.5 * INERTIA * SPEED**2, rtol=1e-7)
    found = run.force("stop")
    assert rates(run)[49] == pytest.approx(SPEED, rel=1e-6)
    assert found["angle"][49] == pytest.approx(0.0, abs=1e-6)
    # Down again, after the impact on the upper stop.
    assert found["angle"][50] == pytest.approx(0.5 - SPEED * (0.37 * period - 0.05 - contact), abs=1e-6)
    assert found["depth"].max() <= SPEED * np.sqrt(INERTIA / STIFFNESS) * (1 + 1e-6)
    np.testing.assert_array_equal(found["depth"][49:], 0.0)


ROADS = {"lane": {}, "stiff lane": {"solver": sj.solvers.Rodas5P()}, "array code": {"scalar": False}}


@pytest.mark.parametrize("road", [*list(ROADS)[:2], pytest.param("array code", marks=pytest.mark.slow)])
def test_each_impact_leaves_the_restitution_squared(road):
    e = 0.7
    ts = np.linspace(0.0, 1.6, 161)
    run = sj.simulate(wheel(-0.5, 0.7, STIFFNESS, restitution=e), ts, rtol=1e-8, **ROADS[road])
    free = np.asarray(run.force("stop")["depth"]) == 0
    speeds = np.unique(np.round(np.abs(rates(run)[free]), 4))[::-1]
    expected = [SPEED]
    while len(expected) < 6:
        expected.append(np.sqrt(e**2 * expected[-1] ** 2 + left_over(e) * 1e-4))
    np.testing.assert_allclose(speeds[:6], expected, rtol=2e-5)
    np.testing.assert_allclose(speeds[1:6] / speeds[:5], e, rtol=1e-4)
    assert run.mechanical_energy[-1] == pytest.approx(0.5 * INERTIA * rates(run)[-1] ** 2)


@pytest.mark.parametrize("e", [0.3, 0.9])
@pytest.mark.parametrize("spring", [None, sj.functions.Polynomial([0.0, 0.0, 0.0, 1e7])])
def test_the_restitution_is_that_of_any_speed_and_spring(e, spring):
    stiffness = STIFFNESS if spring is None else 0.0
    for speed in (0.5, 50.0):
        scene = wheel(None, 0.1 * speed, stiffness, speed=speed, spring=spring, restitution=e)
        after = rates(sj.simulate(scene, np.array([0.0, 0.5]), rtol=1e-9))[-1]
        assert after == pytest.approx(-np.sqrt((e * speed) ** 2 + left_over(e) * 1e-4), rel=1e-5)


def test_a_slide_bounces_by_the_same_law():
    body = sj.Body(2.0, (1.0, 1.0, 1.0), velocity=(0.0, 0.0, -3.0))
    stop = sj.forces.BumpStop(("ground", "b"), shortest=-0.3, stiffness=1e5, direction=Z, restitution=0.7)
    run = sj.simulate(sj.Scene({"b": body}, forces={"stop": stop}, gravity=(0, 0, 0)), np.array([0.0, 0.3]), rtol=1e-9)
    assert run.velocity("b")[-1, 2] == pytest.approx(np.sqrt(2.1**2 + left_over(0.7) * 1e-4), rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_is_any_number_of_turns_away(sign):
    """Between -1 and 23.5 rad, three and three quarters of a turn away: nothing acts before, the stop does there."""
    limits = (-1.0, 23.5) if sign > 0 else (-23.5, 1.0)
    ts = np.array([0.0, 1.0, 2.3, 2.4, 4.0])
    run = sj.simulate(wheel(*limits, STIFFNESS, speed=10.0 * sign, restitution=0.5), ts, rtol=1e-9)
    np.testing.assert_allclose(rates(run), sign * np.array([10.0, 10.0, 10.0, -5.0, -5.0]), rtol=1e-5)
    angle = np.asarray(run.force("stop")["angle"])
    np.testing.assert_allclose(angle[:3], sign * 10.0 * ts[:3], atol=1e-6)
    assert abs(angle[-1]) == pytest.approx(23.5 - 5.0 * (4.0 - 2.35 - contact_time(0.5)), abs=1e-4)


def contact_time(e):
    """A quarter of a period of each of two springs."""
    h = (1 - e * e) / (1 + e * e)
    return np.pi / 2 * np.sqrt(INERTIA / STIFFNESS) * (1 / np.sqrt(1 + h) + 1 / np.sqrt(1 - h))


@pytest.mark.parametrize("way", [jax.jacfwd, pytest.param(jax.grad, marks=pytest.mark.slow)])
def test_derivatives_by_the_restitution_and_the_limit(way):
    """Of the angle after one impact: b - e v (t - b/v - contact(e))."""

    def last(e, limit):
        run = sj.simulate(wheel(None, limit, STIFFNESS, restitution=e), np.array([0.0, 0.2]), rtol=1e-10)
        return run.force("stop")["angle"][-1]

    e, b = 0.7, 0.5
    value, found = last(e, b), way(last, (0, 1))(e, b)
    assert value == pytest.approx(b - e * SPEED * (0.2 - b / SPEED - contact_time(e)), abs=1e-4)
    h = 1e-5
    differences = (
        (last(e + h, b) - last(e - h, b)) / (2 * h),
        (last(e, b + h) - last(e, b - h)) / (2 * h),
    )
    np.testing.assert_allclose(found, differences, rtol=1e-4)
    assert found[1] == pytest.approx(1 + e, rel=1e-3)


def test_restitutions_are_swept():
    many = jax.vmap(lambda e: sj.simulate(wheel(None, 0.5, STIFFNESS, restitution=e), np.array([0.0, 0.2]), rtol=1e-9))
    after = many(jnp.array([0.3, 0.7, 1.0])).angular_velocity("w")[:, -1, 2]
    np.testing.assert_allclose(after, [-3.0, -7.0, -10.0], rtol=1e-4)


def test_what_rests_on_a_stop_stays_there():
    """A torque presses on: it bounces, and comes to rest at the depth T/k."""
    motor = {"motor": sj.Actuator(sj.Turn(ENDS, Z), 5.0)}
    run = sj.simulate(wheel(None, 0.1, STIFFNESS, restitution=0.5, forces=motor), np.array([0.0, 2.0]), throw=True)
    assert run.force("stop")["depth"][-1] == pytest.approx(5.0 / STIFFNESS, rel=1e-4)
    assert rates(run)[-1] == pytest.approx(0.0, abs=1e-4)


def test_backlash_with_damping():
    """A rotor with a dead band of 0.05 rad, 1e4 N m/rad and 2 N m s/rad, driven to and fro, against SciPy."""
    half, c, onset = 0.025, 2.0, 1e-3
    motor = {"motor": sj.Actuator(sj.Turn(ENDS, Z), sj.functions.Sine(20.0, 15.0))}
    ts = np.linspace(0.0, 0.1, 41)
    scene = wheel(-half, half, STIFFNESS, c, onset, speed=3.0, forces=motor)
    run = sj.simulate(scene, ts, rtol=1e-10)

    def resisting(y):
        total = 0.0
        for side in (-1.0, 1.0):
            p, rate = side * y[0] - half, side * y[1]
            if p > 0:
                u = min(p / onset, 1.0)
                elastic = STIFFNESS * (p * u / 2 if u < 1 else p - onset / 2)
                total += side * max(0.0, elastic + u * u * (3 - 2 * u) * c * rate)
        return total

    def slope(t, y):
        return [y[1], (20.0 * np.sin(2 * np.pi * 15.0 * t) - resisting(y)) / INERTIA]

    # Pieces between the kinks: limits and the onset's end.
    def until(edge):
        def event(t, y):
            return y[0] - edge

        event.terminal = True
        return event

    edges = [side * (half + more) for side in (-1.0, 1.0) for more in (0.0, onset)]
    t, y, values = 0.0, np.array([0.0, 3.0]), []
    while t < ts[-1]:
        events = [until(edge) for edge in edges if abs(y[0] - edge) > 1e-12]
        piece = solve_ivp(
            slope, (t, ts[-1]), y, "DOP853", ts[ts >= t], events=events, rtol=1e-12, atol=1e-12, max_step=2e-4
        )
        # Without a sample in the piece SciPy gives lists.
        values += [(a, *b) for a, b in zip(piece.t, np.reshape(piece.y, (2, -1)).T, strict=True)]
        if not piece.t_events or not any(len(one) for one in piece.t_events):
            break
        t, y = next((a[0], b[0]) for a, b in zip(piece.t_events, piece.y_events, strict=True) if len(a))
    reference = np.array(sorted({round(a, 12): (a, *b) for a, *b in values}.values()))
    np.testing.assert_allclose(reference[:, 0], ts)
    assert np.ptp(reference[:, 1]) > 2 * half
    np.testing.assert_allclose(run.force("stop")["angle"], reference[:, 1], atol=1e-6)
    np.testing.assert_allclose(rates(run), reference[:, 2], atol=1e-4)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"smallest": 0.2, "largest": 0.1}, "largest = 0.1 must be above smallest"),
        ({"largest": np.nan}, "largest = nan must be"),
        ({"stiffness": 0.0}, "stiffness = 0 must be positive"),
        ({"stiffness": -1.0}, "stiffness = -1 must be positive"),
        ({"damping": 1.0}, "onset = 0 must be positive with damping"),
        ({"damping": 1.0, "onset": 0.1, "restitution": 0.5}, "restitution = 0.5 must stand without damping"),
        ({"restitution": 0.0}, r"restitution = 0 must lie in \(0, 1\]"),
        ({"restitution": 1.1}, r"restitution = 1.1 must lie in \(0, 1\]"),
        ({"restitution": 0.5, "transition": 0.0}, r"transition = 0 must be positive.*\[rad/s\]"),
        ({"axis": (0, 0, 0)}, "axis = .* must be a direction"),
        ({"bodies": ("w", "w")}, "bodies = .* must be two bodies"),
    ],
)
def test_bad_input_is_named(more, message):
    given = {"bodies": ENDS, "axis": Z, "largest": 0.5, "stiffness": 1.0, **more}
    scene = sj.Scene({"w": sj.Body(1.0, (1.0, 1.0, 1.0))}, forces={"stop": sj.forces.TorsionalStop(**given)})
    with pytest.raises(sj.SceneError, match=message):
        sj.equations.compile_scene(scene)


def test_a_stop_without_a_limit_is_refused():
    with pytest.raises(TypeError, match="smallest= or largest="):
        sj.forces.TorsionalStop(ENDS, Z, stiffness=1.0)
