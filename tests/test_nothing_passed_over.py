"""What lasts for less than a step is met all the same: stops, tyres, bumps in a road, jolts of a drive."""

import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.runs.many import simulate_many
from spherejax.physics.functions.base import distance_to_next

G = 9.81


def ball(**motion) -> sj.Body:
    return sj.Body(1.0, (1e-2, 1e-2, 1e-2), **motion)


def dropped(height: float, stiffness: float) -> sj.Scene:
    """A ball above a stiff stop at the height 0."""
    stop = sj.forces.BumpStop(("ground.floor", "ball"), shortest=0.0, stiffness=stiffness, direction=(0, 0, 1))
    return sj.Scene(
        {"ball": ball(position=(0.0, 0.0, height))}, {}, forces={"stop": stop}, ground_points={"floor": (0.0, 0.0, 0.0)}
    )


def bounced(height: float, stiffness: float, t: np.ndarray) -> np.ndarray:
    """Its height: parabolas of flight, and half periods of an oscillator under weight between."""
    omega, v = np.sqrt(stiffness), np.sqrt(2 * G * height)
    fall, sag = v / G, G / stiffness
    contact = 2 * (np.pi - np.arctan2(v / omega, sag)) / omega
    since = (t - fall) % (contact + 2 * fall)
    inside = sag * (np.cos(omega * since) - 1) - v / omega * np.sin(omega * since)
    after = since - contact
    flying = v * after - G / 2 * after**2
    return np.where(t < fall, height - G / 2 * t**2, np.where(since < contact, inside, flying))


@pytest.mark.parametrize("stiffness", [1e6, 1e10])
def test_a_stop_that_is_touched_for_less_than_a_step(stiffness):
    times = jnp.linspace(0.0, 1.0, 41)
    run = sj.simulate(dropped(0.05, stiffness), times, rtol=1e-8)
    assert run.succeeded
    expected = bounced(0.05, stiffness, np.asarray(times))
    assert np.max(np.abs(run.position("ball")[:, 2] - expected)) < 1e-6


def test_the_same_in_lanes_for_every_stiffness():
    stiffness = jnp.logspace(4, 11, 8)
    times = jnp.linspace(0.0, 0.5, 11)
    runs = simulate_many(lambda stiffness: dropped(0.05, stiffness), {"stiffness": stiffness}, times).trajectories
    assert np.all(runs.succeeded)
    for run in range(8):
        expected = bounced(0.05, float(stiffness[run]), np.asarray(times))
        assert np.max(np.abs(runs.ys[run, :, 2] - expected)) < 1e-6


@pytest.mark.parametrize(
    ("stiffness", "rtol"), [(1e6, 1e-6), (1e4, 1e-8), pytest.param(1e6, 1e-10, marks=pytest.mark.slow)]
)
def test_a_stop_that_only_stages_without_a_weight_have_met(stiffness, rtol):
    """Of such a step the error says nothing: 14 of 400 runs fell through the first stop, and failed their audit."""
    heights, times = jnp.linspace(0.01, 0.5, 400), jnp.linspace(0.0, 1.0, 11)
    runs = simulate_many(lambda height: dropped(height, stiffness), {"height": heights}, times, rtol=rtol).trajectories
    assert np.all(runs.succeeded)
    expected = np.stack([bounced(height, stiffness, np.asarray(times)) for height in np.asarray(heights)])
    assert np.max(np.abs(runs.ys[:, :, 2] - expected)) < 30 * rtol


def driven_over(bump: sj.functions.Bump, speed: float = 20.0) -> sj.Scene:
    """A wheel at rest on its tyre, which a road passes below."""
    radius, stiffness = 0.3, 2e5
    tyre = sj.forces.Tyre("wheel", radius, stiffness, road=bump, speed=speed)
    return sj.Scene({"wheel": ball(position=(0.0, 0.0, radius - G / stiffness))}, {}, forces={"tyre": tyre})


def test_a_bump_shorter_than_any_step_is_met():
    # 2 mm of road, 0.1 ms of 2 s: the wheel gets the impulse of the bump's area over the speed.
    bump = sj.functions.Bump(height=1e-3, start=20.123, length=2e-3)
    run = sj.simulate(driven_over(bump), jnp.array([0.0, 1.0, 1.01]), rtol=1e-8)
    impulse = 2e5 * bump.height * bump.length / 2 / 20.0
    top = run.velocity("wheel")[-1, 2] ** 2 + 2e5 * (run.position("wheel")[-1, 2] - run.position("wheel")[0, 2]) ** 2
    assert float(jnp.sqrt(top)) == pytest.approx(impulse, rel=2e-2)


def test_a_jolt_of_a_drive_shorter_than_any_step_is_met():
    jolt = sj.functions.Bump(height=1e-2, start=0.51234, length=2e-4)
    scene = sj.Scene(
        {"rider": ball(position=(0.0, 0.0, 0.0)), "load": ball(position=(0.0, 0.0, -0.1))},
        {
            "guide": sj.Prismatic(("ground", "rider"), point=(0, 0, 0), axis=(0, 0, 1)),
            "drive": sj.TranslationDriver(("ground", "rider"), point=(0, 0, 0), axis=(0, 0, 1), travel=jolt),
        },
        forces={"spring": sj.SpringDamper(("rider", "load"), stiffness=1e4, free_length=0.1)},
        gravity=(0.0, 0.0, 0.0),
    )
    run = sj.simulate(scene, jnp.array([0.0, 0.5, 0.6]), rtol=1e-8)
    # The load gets k times the area of the jolt.
    rate = run.velocity("load")[-1, 2] ** 2 + 1e4 * (run.position("load")[-1, 2] + 0.1) ** 2
    assert float(jnp.sqrt(rate)) == pytest.approx(1e4 * 1e-2 * 2e-4 / 2, rel=2e-2)


def test_where_functions_begin_end_and_turn():
    bump, table = sj.functions.Bump(1.0, 2.0, 1.0), sj.functions.Table([0.0, 1.0, 4.0], [0.0, 1.0, 0.0])
    assert float(bump.distance_to_breakpoint(0.5, True)) == 1.5
    assert float(bump.distance_to_breakpoint(2.0, True)) == 0.5  # its crest; what a step ends on is passed
    assert float(bump.distance_to_breakpoint(4.0, False)) == 1.0
    assert float(bump.distance_to_breakpoint(4.0, True)) == np.inf
    assert float(table.distance_to_breakpoint(1.5, True)) == 2.5
    assert float(table.distance_to_breakpoint(1.5, False)) == 0.5
    assert float(sj.functions.Sine(1.0, 50.0).distance_to_breakpoint(3.0, True)) == 0.01
    assert float(sj.functions.Sum(bump, table).distance_to_breakpoint(0.5, True)) == 0.5
    assert float(distance_to_next([1.0, 2.0], 1.0, True)) == 1.0


def test_a_class_that_overrides_the_earlier_name_is_served_and_told():
    with pytest.warns(DeprecationWarning, match="Late.room is now called distance_to_breakpoint; rename the method"):

        class Late(sj.functions.AbstractFunction):
            at: float

            def __call__(self, x):
                return jnp.where(x < self.at, 0.0, 1.0)

            def room(self, x, is_forward):
                assert super().room(x, is_forward) is None
                return jnp.where(x < self.at, self.at - x, jnp.inf)

    late = Late(0.3)
    with pytest.warns(DeprecationWarning, match="Late.room is now called"):
        assert float(late.distance_to_breakpoint(0.1, True)) == 0.3 - 0.1
    assert not late.is_unknown
    with pytest.warns(DeprecationWarning, match="Table.room is now called"):
        assert float(sj.functions.Table([0.0, 1.0], [0.0, 1.0]).room(0.25, True)) == 0.75


def test_a_force_that_overrides_the_earlier_name_ends_steps_at_its_pulse():
    begin, end = 0.51234, 0.51235  # a hundred-thousandth of the motion: shorter than what is looked for

    with pytest.warns(DeprecationWarning, match="Pulse.room is now called time_to_breakpoint; rename the method"):

        class Pulse(sj.forces.AbstractForce):
            def wrenches(self, t, motions):
                push = jnp.where((t >= begin) & (t < end), 1e5, 0.0)
                return {"body": sj.forces.Wrench(jnp.array([push, 0.0, 0.0]), jnp.zeros(3))}

            def room(self, t, motions):
                return jnp.min(jnp.where(t < jnp.array([begin, end]), jnp.array([begin, end]) - t, jnp.inf))

    scene = sj.Scene({"body": sj.Body(2.0, (1.0, 1.0, 1.0))}, forces={"pulse": Pulse()}, gravity=(0.0, 0.0, 0.0))
    run = sj.simulate(scene, jnp.linspace(0.0, 1.0, 3))
    np.testing.assert_allclose(run.velocity("body")[-1, 0], 1e5 * (end - begin) / 2.0, rtol=1e-6)
