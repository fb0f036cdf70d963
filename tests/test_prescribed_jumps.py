"""Prescribed motions that jump are refused; where only the rate jumps, the impact of the driver is landed on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spherejax as sj

# Some functions begin with another rate than the rod has.
pytestmark = pytest.mark.filterwarnings("ignore::spherejax.errors.StartWarning")

AXIS = (0.0, 0.0, 1.0)
TIMES = np.linspace(0.0, 2.0, 5)
TURN, SPEED = 0.7, 1.0


def arm(angle, tail=False, drift=None):
    """A rod of 2 m that is turned about its end, and, with a tail, another that swings at its tip, without weight."""
    moments = (0.01, 1 / 3, 1 / 3)
    turning = {"velocity": (0.0, SPEED, 0.0), "angular_velocity": (0.0, 0.0, SPEED)}
    bodies = {"rod": sj.Body(1.0, moments, (1.0, 0.0, 0.0), **turning)}
    joints = {
        "hinge": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), AXIS),
        "motor": sj.RotationDriver(("ground", "rod"), AXIS, angle),
    }
    if tail:
        swing = {"velocity": (0.0, 2 * SPEED, 0.0)}
        bodies["tail"] = sj.Body(1.0, moments, (3.0, 0.0, 0.0), **swing)
        joints["tip"] = sj.Revolute(("rod", "tail"), (2.0, 0.0, 0.0), AXIS)
    return sj.Scene(bodies, joints, gravity=(0.0, 0.0, 0.0), drift=drift)


class Ramp(sj.functions.AbstractFunction):
    """Goes on from 0 at a rate, and jumps by `jump` at `at`."""

    jump: jax.Array
    at: float = 0.5

    def __call__(self, x):
        return SPEED * x + jnp.where(x < self.at, 0.0, self.jump)


JUMPING = {
    "step": (sj.functions.Step(0.5, 0.0, 9e-3), "jumps at t = 0.5 s from 0 to 0.009"),
    "function": (lambda t: jnp.where(t < 0.3, jnp.sin(t), jnp.sin(t) + 1e-5), "jumps at t = 0.3 s"),
    "module": (Ramp(jnp.asarray(9e-3)), "jumps at t = 0.5 s"),
    "short": (
        sj.functions.Piecewise(
            [0.5, 0.50001], [sj.functions.Linear(1.0), sj.functions.Linear(1.0, 0.1), sj.functions.Linear(1.0)]
        ),
        "jumps at t = 0.5",
    ),
    "kink": (lambda t: jnp.minimum(t, TURN), "the rate of its function of time jumps at t = 0.7 s from 1 to 0"),
}


@pytest.mark.parametrize("kind", JUMPING)
@pytest.mark.parametrize("drift", [sj.solvers.Projection(), sj.solvers.Baumgarte()])
def test_a_motion_that_jumps_is_refused_before_anything_is_computed(kind, drift):
    """The step ended at 0.0064 rad half a second later with Baumgarte's feedback, and teleported with corrections."""
    function, text = JUMPING[kind]
    with pytest.raises(sj.SceneError, match=f"driver 'motor': .*{text}"):
        sj.simulate(arm(function, drift=drift), TIMES)


def test_one_with_traced_numbers_is_a_bad_value_of_its_lane():
    def status(jump):
        return sj.simulate(arm(Ramp(jump)), TIMES).status

    found = jax.jit(jax.vmap(status))(jnp.array([0.0, 1e-3]))
    assert found.tolist() == [sj.Status.SUCCEEDED, sj.Status.BAD_VALUE]


def test_many_runs_with_one_that_jumps_are_bad_values():
    runs = sj.simulate_many(lambda jump: arm(Ramp(jump)), {"jump": jnp.array([1e-3, 0.0])}, TIMES).trajectories
    assert runs.status.tolist() == [sj.Status.BAD_VALUE, sj.Status.SUCCEEDED]


@pytest.mark.parametrize(
    "function",
    [
        lambda t: jnp.sin(40 * t) * jnp.exp(-t),
        lambda t: jnp.tanh(1e4 * (t - 0.5)),
        lambda t: jnp.where(t < 0.5, 0.0, (t - 0.5) ** 2),
        Ramp(jnp.asarray(0.0)),
    ],
)
def test_steep_and_fast_motions_are_not_taken_for_jumps(function):
    assert sj.simulate(arm(function), [0.0, 0.6]).succeeded


def tail_after_the_turn(ts):
    """Angle of the tail, whose hinge goes round until `TURN` and stops: its momentum about the hinge jumps."""
    inertia = 1 / 3 + 1.0

    def rate(_, y, spin):
        pull = -2 * spin**2 * np.array([np.cos(y[2]), np.sin(y[2])])
        return [y[1], -(pull @ [-np.sin(y[0]), np.cos(y[0])]) / inertia, spin]

    accuracy = {"rtol": 1e-12, "atol": 1e-12}
    before = solve_ivp(rate, (0.0, TURN), [0.0, 0.0, 0.0], args=(SPEED,), **accuracy).y[:, -1]
    stop = -2 * SPEED * np.array([-np.sin(before[2]), np.cos(before[2])])
    spin = before[1] - stop @ [-np.sin(before[0]), np.cos(before[0])] / inertia
    return before[0] + spin * (ts - TURN)


TURNING = {
    "table": sj.functions.Table([0.0, TURN, 2.0], [0.0, SPEED * TURN, SPEED * TURN]),
    "plain functions": sj.functions.Piecewise([TURN], [lambda t: SPEED * t, lambda t: SPEED * TURN]),
}


@pytest.mark.parametrize("kind", TURNING)
@pytest.mark.parametrize("drift", [sj.solvers.PostStabilization(), sj.solvers.Projection()])
def test_a_jump_of_the_rate_is_an_impact_of_the_driver(kind, drift):
    run = sj.simulate(arm(TURNING[kind], True, drift), TIMES, throw=True)
    quaternion = np.asarray(run.quaternion("tail"))
    angle = 2 * np.arctan2(quaternion[:, 3], quaternion[:, 0])
    assert angle[2:] == pytest.approx(tail_after_the_turn(TIMES[2:]), abs=1e-7)
    # What the motor took in the impact is in the account of the work that is put in: half of the energy. The account
    # is coarse, for at the end of the step that ends there a stage sees the rate after it.
    energy = np.asarray(run.mechanical_energy - run.supplied_work)
    assert energy == pytest.approx(energy[0], rel=1e-3)


def test_the_error_for_a_kink_says_how_to_declare_it():
    def function(t):
        return jnp.minimum(SPEED * t, SPEED * TURN)

    with pytest.raises(sj.SceneError, match=r"sj\.functions\.Piecewise\(\[0\.7\], \[f, g\]\)"):
        sj.simulate(arm(function), TIMES)


@pytest.mark.slow
def test_a_kink_declared_with_the_same_function_on_both_sides_does_not_succeed():
    """It has half of the jump at the break, which no motion can have."""

    def function(t):
        return jnp.minimum(SPEED * t, SPEED * TURN)

    with pytest.warns(sj.SimulationWarning, match="energy"):
        assert not sj.simulate(arm(sj.functions.Piecewise([TURN], [function, function]), True), TIMES).succeeded


def test_a_jump_of_the_rate_that_feedback_would_follow_slowly_ends_the_run():
    table = sj.functions.Table([0.0, TURN, 2.0], [0.0, SPEED * TURN, SPEED * TURN])
    with pytest.warns(sj.SimulationWarning, match="energy vanished"):
        run = sj.simulate(arm(table, True, sj.solvers.Baumgarte()), TIMES)
    assert run.status == sj.Status.AUDIT_FAILED
