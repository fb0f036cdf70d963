"""Motors by speed: the integral of a rate as what a driver prescribes, against closed forms and SciPy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import spherejax as sj

AXIS = (0.0, 0.0, 1.0)
INERTIA = 0.02
TS = np.linspace(0.0, 1.0, 11)


def spin(t):
    """A speed without a formula in the package [rad/s]."""
    return 4.0 * jnp.exp(-t) * jnp.cos(3.0 * t)


def stall(t):
    """Another one."""
    return 2.0 / (1.0 + t * t)


PIECES = sj.functions.Piecewise([0.35], [spin, stall])
RATES: dict[str, Any] = {
    "constant": 5.0,
    "ramp": sj.functions.Linear(3.0, 0.5),
    "sine": sj.functions.Sine(2.0, 1.5, 0.2, 0.4),
    "profile": sj.functions.SmoothStep(0.1, 0.6, 0.0, 8.0),
    "table": sj.functions.Table([0.0, 0.25, 0.7, 1.0], [0.0, 6.0, 6.0, -1.0]),
}
VALUES = {
    "constant": lambda t: 5.0,
    "ramp": lambda t: 0.5 + 3.0 * t,
    "sine": lambda t: 0.4 + 2.0 * np.sin(3.0 * np.pi * t + 0.2),
    "profile": lambda t: 8.0 * np.polyval([6.0, -15.0, 10.0, 0.0, 0.0, 0.0], np.clip((t - 0.1) / 0.5, 0.0, 1.0)),
    "table": lambda t: np.interp(t, [0.0, 0.25, 0.7, 1.0], [0.0, 6.0, 6.0, -1.0]),
    "function": lambda t: 4.0 * np.exp(-t) * np.cos(3.0 * t),
}


@pytest.fixture(scope="module")
def run() -> sj.Trajectory:
    """Rotors side by side, each by its own speed, and a slide."""
    bodies = {name: sj.Body(1.0, (0.01, 0.01, INERTIA)) for name in VALUES}
    joints: dict[str, Any] = {f"{name}_bearing": sj.Revolute(("ground", name), (0, 0, 0), AXIS) for name in bodies}
    for name, rate in RATES.items():
        joints[f"{name}_motor"] = sj.RotationDriver(("ground", name), AXIS, rate=rate, start=0.3)
    angle = sj.functions.Integral(spin, 0.3, until=1.0)
    joints["function_motor"] = sj.RotationDriver(("ground", "function"), AXIS, angle)
    return sj.simulate(sj.Scene(bodies, joints, gravity=(0, 0, 0)), TS, rtol=1e-9)


@pytest.mark.parametrize("name", sorted(VALUES))
def test_angle_is_the_integral_of_the_speed(run, name):
    speed = VALUES[name]
    kinks = {"table": [0.25, 0.7], "profile": [0.1, 0.6]}.get(name)
    angles = np.array([0.3 + quad(speed, 0.0, t, epsabs=1e-13, points=kinks if t > 0 else None)[0] for t in TS])
    q = run.quaternion(name)
    np.testing.assert_allclose(np.exp(2j * np.arctan2(q[:, 3], q[:, 0])), np.exp(1j * angles), atol=1e-9)
    np.testing.assert_allclose(run.angular_velocity(name)[:, 2], [speed(t) for t in TS], atol=1e-8)


def test_effort_and_energy_of_the_motors(run):
    """J times the acceleration; all work goes into the rotors, and the audit of the run agrees."""
    assert run.status == sj.Status.SUCCEEDED
    np.testing.assert_allclose(run.driving_effort("ramp_motor"), INERTIA * 3.0, atol=1e-9)
    wanted = INERTIA * 2.0 * 3.0 * np.pi * np.cos(3.0 * np.pi * TS + 0.2)
    np.testing.assert_allclose(run.driving_effort("sine_motor"), wanted, atol=1e-7)
    gained = run.kinetic_energy - run.kinetic_energy[0]
    # Kinks of the table's speed are no impacts: the work that is integrated is all there is.
    np.testing.assert_allclose(run.supplied_work, gained, atol=1e-7)


FUNCTIONS: dict[str, sj.functions.AbstractFunction] = {
    "quadrature": sj.functions.Integral(spin, 0.2, origin=-0.3, until=2.0),
    "pieces by quadrature": sj.functions.Integral(PIECES, until=2.0),
    "pieces, one a formula": sj.functions.Integral(
        sj.functions.Piecewise([0.5], [sj.functions.Sine(1.0, 2.0), stall]), until=2.0
    ),
    "a sum": sj.functions.Integral(
        sj.functions.Sum(sj.functions.Linear(1.0), sj.functions.UserFunction(spin)), until=2.0
    ),
    "origin behind the breaks": sj.functions.Integral(PIECES, 1.0, origin=0.6, until=2.0),
}


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_quadrature_is_that_of_scipy(name):
    function: Any = FUNCTIONS[name]
    program = sj.compiler.scalarize(function, jnp.zeros(()))
    rate = sj.compiler.scalarize(function.rate, jnp.zeros(()))
    breaks = [0.35, 0.5]
    for x in (float(function.origin), 0.35, 0.61, 1.37, 2.0):
        if x < function.origin:
            continue
        inside = [each for each in breaks if function.origin < each < x] or None
        wanted = quad(rate.compute, float(function.origin), x, epsabs=1e-13, points=inside)[0]
        np.testing.assert_allclose(program.compute(x) - function.start, wanted, atol=1e-12)


def test_derivatives_by_the_numbers_of_a_rate():
    """By a number that a Python function closes over, and by a break: the rate's jump there."""

    def by_number(a):
        return sj.functions.Integral(lambda t: jnp.exp(-a * t), until=2.0)(1.3)

    def by_break(at):
        return sj.functions.Integral(sj.functions.Piecewise([at], [spin, stall]), until=2.0)(1.3)

    slope, wanted = jax.grad(by_number)(0.7), quad(lambda t: -t * np.exp(-0.7 * t), 0.0, 1.3)[0]
    np.testing.assert_allclose(slope, wanted, rtol=1e-12)
    np.testing.assert_allclose(jax.grad(by_break)(0.35), spin(0.35) - stall(0.35), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(sj.functions.Integral(spin, until=2.0))(1.3), spin(1.3), rtol=1e-11)


def crank(driver: sj.RotationDriver) -> sj.Scene:
    """One rotor and its motor."""
    bearing = sj.Revolute(("ground", "rotor"), (0, 0, 0), AXIS)
    return sj.Scene({"rotor": sj.Body(1.0, (0.01, 0.01, INERTIA))}, {"bearing": bearing, "motor": driver})


def motor(*arguments: Any, **more: Any) -> sj.RotationDriver:
    """Of the rotor."""
    return sj.RotationDriver(("ground", "rotor"), AXIS, *arguments, **more)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: motor(), "give angle= or rate=.*neither"),
        (lambda: motor(sj.functions.Linear(1.0), rate=1.0), "not both"),
        (lambda: motor(sj.functions.Linear(1.0), start=0.2), "start= belongs to rate="),
        (lambda: motor(rate=spin), r"angle.until.*no formula.*until=2.0"),
        (lambda: motor(sj.functions.Integral(spin, until=-1.0)), "until = -1 must be above origin"),
        (
            lambda: motor(sj.functions.Integral(lambda t: jnp.sin(400.0 * t), until=2.0)),
            "panels = 16 must be enough.*panels=64",
        ),
        (
            lambda: motor(sj.functions.Integral(lambda t: jnp.where(t < 0.31, 0.0, 1.0), until=2.0)),
            "must be enough.*Piecewise",
        ),
        (
            lambda: motor(sj.functions.Integral(spin, until=0.5)),
            r"known from 0 s to 0.5 s, and the run goes from 0 s to 1 s",
        ),
        (lambda: motor(rate=np.nan), "finite"),
    ],
)
def test_bad_rates_say_so(make, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.simulate(crank(make()), TS)


def test_files_take_a_speed(tmp_path):
    path = tmp_path / "crank.toml"
    path.write_text(
        """
[bodies.rotor]
mass = 1.0
inertia = [0.01, 0.01, 0.02]

[joints]
bearing = { kind = "revolute", bodies = ["ground", "rotor"], point = [0, 0, 0], axis = [0, 0, 1] }
motor = { kind = "rotation-driver", bodies = ["ground", "rotor"], axis = [0, 0, 1], rate = "300 rpm", start = "90 deg" }
"""
    )
    angle: Any = sj.load_scene(path).joints["motor"]
    np.testing.assert_allclose([angle.angle(0.0), angle.angle(0.1)], [np.pi / 2, 1.5 * np.pi], rtol=1e-14)
    again = tmp_path / "again.toml"
    sj.save_scene(sj.load_scene(path), again)
    same: Any = sj.load_scene(again).joints["motor"]
    assert same.angle(0.1) == angle.angle(0.1)
    path.write_text(path.read_text().replace("300 rpm", "3 m/s"))
    with pytest.raises(sj.SceneError, match=r"rate.*an angular velocity \[rad/s\] is expected"):
        sj.load_scene(path)


@pytest.mark.slow
def test_runs_are_differentiated_and_swept_by_a_speed():
    """The place of a rotor's point by the amplitude of its speed; traced times beyond `until` are a status."""

    @jax.jit
    def end(amplitude):
        angle = sj.functions.Integral(lambda t: amplitude * jnp.exp(-t), 0.3, until=1.0)
        return sj.simulate(crank(motor(angle)), TS, rtol=1e-9).quaternion("rotor")[-1, 3]

    share = 1.0 - np.exp(-1.0)
    np.testing.assert_allclose(
        jax.vmap(end)(jnp.array([1.0, 2.0])), np.sin(0.15 + share * np.array([0.5, 1.0])), atol=1e-9
    )
    np.testing.assert_allclose(jax.grad(end)(2.0), 0.5 * share * np.cos(0.15 + share), rtol=1e-7)
    late = jax.jit(lambda last: sj.simulate(crank(motor(sj.functions.Integral(spin, until=1.0))), TS * last).status)
    assert late(1.0) == sj.Status.SUCCEEDED
    assert late(1.5) != sj.Status.SUCCEEDED
