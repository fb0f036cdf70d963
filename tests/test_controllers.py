"""Forces with states of their own, controllers and sampled signals, against linear algebra and SciPy."""

import inspect
import itertools
import textwrap
import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from controlling import (
    GAINS,
    ROTOR,
    ROTOR_FILE,
    NeuralForce,
    continuous_answer,
    motor,
    sampled_answer,
    sampled_motor,
)
from jax.flatten_util import ravel_pytree
from scipy.integrate import simpson, solve_ivp

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.sampling import samples_of
from spherejax.motion.solvers.automatic import choose_solver
from spherejax.physics.kinematics import BodyMotion

TS = np.linspace(0.0, 1.0, 41)
"""Among them instants of samples, and others."""


def _seen(run: sj.Trajectory) -> np.ndarray:
    found = run.force("motor")
    return np.column_stack([found["position"], found["rate"], found["effort"]])


# A digital controller -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tight() -> tuple[sj.Trajectory, sj.Trajectory]:
    """Two runs of one scene at two tight tolerances."""
    return tuple(sj.simulate(sampled_motor(0.01), TS, rtol=rtol) for rtol in (1e-11, 1e-12))  # pyright: ignore[reportReturnType]


def test_digital_controller_is_the_exact_one(tight):
    wanted = sampled_answer(TS)
    np.testing.assert_allclose(_seen(tight[0]), wanted, atol=2e-10 * np.abs(wanted).max())


def test_digital_controller_does_not_depend_on_the_tolerance(tight):
    np.testing.assert_allclose(_seen(tight[0]), _seen(tight[1]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(tight[0].ys, tight[1].ys, rtol=0, atol=1e-9)


def test_steps_end_on_samples(tight):
    """All hundred of them, without a step more than the samples and the plant ask for."""
    assert tight[0].stats.n_accepted >= 100
    loose = sj.simulate(sampled_motor(0.01), TS, rtol=1e-5)
    assert loose.stats.n_accepted == 100
    np.testing.assert_array_equal(loose.memory("motor")["samples"], 1 + np.floor(TS / 0.01 + 1e-9))
    np.testing.assert_allclose(_seen(loose), sampled_answer(TS), atol=1e-4)


def test_torque_of_a_controller_is_supplied_work(tight):
    run = tight[0]
    fed = run.supplied_work - run.mechanical_energy + run.mechanical_energy[0]
    fine = np.linspace(0.0, 1.0, 401)
    speed = sampled_answer(fine)[:, 1]
    np.testing.assert_allclose(fed[-1], simpson(0.02 * speed**2, x=fine), rtol=1e-5)  # lost in the spring's damper


NAMES = ("period", "inertia", "proportional", "integral", "derivative")
POINT = np.array([0.0107, 0.02, 0.8, 2.0, 0.05])


def _angles(values):
    named = dict(zip(NAMES, values, strict=True))
    return sj.simulate(sampled_motor(named.pop("period"), **named), TS, rtol=1e-9).force("motor")["position"]


@pytest.mark.slow
def test_lanes_and_derivatives_pass_through_samples():
    """By the period too, whose samples move: three periods side by side, against differences of the exact answer."""
    points = np.stack([POINT, POINT * [1.3, 1, 1, 1, 1], POINT * [4.1, 1, 1, 0.5, 1]])

    def twice(point):
        angles = _angles(point)
        return angles, angles

    slopes, values = jax.vmap(jax.jacfwd(twice, has_aux=True))(jnp.asarray(points))
    for point, value, slope in zip(points, values, slopes, strict=True):
        np.testing.assert_allclose(value, _exact(point), atol=2e-8)
        steps = 1e-6 * point
        differences = [(_exact(point + d) - _exact(point - d)) / (2 * d.max()) for d in np.diag(steps)]
        scale = np.abs(differences).max(axis=1)
        # Differences lose six digits of the exact answer's; an instant passes a sample time nowhere here.
        np.testing.assert_allclose(slope.T / scale[:, None], differences / scale[:, None], atol=1e-6)


def _exact(point) -> np.ndarray:
    named = {name: float(value) for name, value in zip(NAMES, point, strict=True)}
    return sampled_answer(TS, named.pop("period"), named.pop("inertia"), **named)[:, 0]


@pytest.mark.slow
def test_delay_and_first_sample():
    late = sj.forces.SampledPID(ROTOR, 0.02, 1.5, **GAINS, first_sample=0.013, delayed=True)
    run = sj.simulate(motor(late), TS, rtol=1e-11)
    wanted = sampled_answer(TS, 0.02, first=0.013, delayed=True)
    np.testing.assert_allclose(_seen(run), wanted, atol=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [sj.solvers.Rodas5P(), "Kvaerno5", "Tsit5"])
def test_any_method_lands_on_samples(solver):
    import diffrax

    method: Any = getattr(diffrax, solver)() if isinstance(solver, str) else solver
    run = sj.simulate(sampled_motor(0.01), TS, rtol=1e-9, solver=method)
    np.testing.assert_allclose(_seen(run), sampled_answer(TS), atol=2e-6)

    def angle(gain):
        return sj.simulate(sampled_motor(0.01, proportional=gain), TS, rtol=1e-9, solver=method).force("motor")[
            "position"
        ]

    slope = jax.jvp(angle, (0.8,), (1.0,))[1]
    difference = (sampled_answer(TS, proportional=0.8 + 1e-6) - sampled_answer(TS, proportional=0.8 - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope, difference[:, 0], atol=1e-5)


@pytest.mark.slow
def test_back_along_the_steps():
    """The reverse sweep passes the samples too."""
    at = {name: float(value) for name, value in zip(NAMES, POINT, strict=True)}

    def last(run):
        return run.force("motor")["position"][-1]

    found = sj.sensitivity(sampled_motor, at, jnp.asarray(TS), of=last, mode="reverse", rtol=1e-9)
    differences = [(_exact(POINT + d) - _exact(POINT - d))[-1] / (2 * d.max()) for d in np.diag(1e-6 * POINT)]
    np.testing.assert_allclose(found.columns[0].slopes.ravel(), differences, rtol=1e-5)


@pytest.mark.slow
def test_sweep_of_periods():
    def build(period):
        return sampled_motor(period)

    periods = np.array([0.01, 0.02, 0.04])
    found = sj.sweep(build, {"period": periods}, ts=jnp.asarray(TS), record=("motor.position",), rtol=1e-9)
    for i, period in enumerate(periods):
        np.testing.assert_allclose(found["motor.position"][i], sampled_answer(TS, period)[:, 0], atol=1e-7)


@pytest.mark.slow
def test_pendulum_under_digital_control_that_meets_a_stop():
    """Nonlinear, with touches beside the samples: SciPy, started anew at every sample, in steps that see the stop."""
    length, period, stop, stiffness = 0.5, 0.02, 0.4, 2e3
    arm = sj.Body(1.0, (0.01, 0.01, 0.01), position=(length, 0.0, 0.0), points={"tip": (0.0, 0.0, 0.0)})
    pivot = sj.Revolute(("ground", "arm"), point=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    turn = sj.Turn(("ground", "arm"), axis=(0.0, -1.0, 0.0))  # counts upwards
    control = sj.forces.SampledPID(turn, period, sj.functions.SmoothStep(0.0, 0.3, 0.0, 1.2), 30.0, 60.0, 2.0)
    floor = sj.forces.BumpStop(("ground", "arm.tip"), longest=stop, stiffness=stiffness, direction=(0.0, 0.0, 1.0))
    scene = sj.Scene({"arm": arm}, {"pivot": pivot}, {"motor": control, "stop": floor})
    ts = np.linspace(0.0, 1.0, 26)
    runs = [sj.simulate(scene, ts, rtol=rtol) for rtol in (1e-10, 1e-12)]
    seen = [np.asarray(run.force("motor")["position"]) for run in runs]
    np.testing.assert_allclose(*seen, rtol=0, atol=1e-8)
    np.testing.assert_allclose(seen[1], _pendulum(ts, length, period, stop, stiffness), atol=1e-7)
    assert length * np.sin(seen[1]).max() > stop


def _pendulum(ts, length, period, stop, stiffness) -> np.ndarray:
    """The angle above the horizontal."""
    smooth = sj.functions.SmoothStep(0.0, 0.3, 0.0, 1.2)
    y, i, z, found = np.zeros(2), 0.0, 0.0, []
    for k in range(round(ts[-1] / period) + 1):
        t = k * period
        e = float(smooth(t)) - y[0]
        torque = 30.0 * e + i + 2.0 * (e - z) / period
        i, z = i + period * 60.0 * e, e

        def by_hand(t, y, torque=torque):
            height = length * np.sin(y[0])
            press = stiffness * max(height - stop, 0.0)
            return [y[1], (torque - (9.81 + press) * length * np.cos(y[0])) / (0.01 + length**2)]

        at = ts[(ts >= t - 1e-12) & (ts < t + period - 1e-12)]
        grid = np.unique(np.clip([t, *at, t + period], t, t + period))
        done = solve_ivp(by_hand, (t, t + period), y, "DOP853", grid, rtol=1e-11, atol=1e-13, max_step=period / 40)
        found += [done.y[0, np.argmin(abs(done.t - each))] for each in at]
        y = done.y[:, -1]
    return np.array(found)


# In continuous time, and signals --------------------------------------------------------------------------------------


def _lag(strength: float, time: float) -> sj.forces.AbstractForce:
    """The element in the docstring of `AbstractForceWithMemory`, as a reader would copy it."""
    text = inspect.getdoc(sj.forces.AbstractForceWithMemory) or ""
    block = text[text.index("    class ") : text.index("What is remembered")]
    scope: dict[str, Any] = {"sj": sj, "jnp": jnp}
    exec(textwrap.dedent(block).replace("'''", '"""'), scope)
    return scope["Lag"](strength, time)


SIGNAL = np.array([0.0, 2.0, -1.0, 0.5]), np.array([0.1, 0.25, 0.6, 0.9])
"""Values [N] and times [s]."""

WHEEL, LIMITS = sj.Turn(("ground", "wheel"), axis=(0.0, 0.0, 1.0)), (-0.4, 0.15)


@pytest.fixture(scope="module")
def many() -> sj.Trajectory:
    """Motors under control, of angle and of speed, and balls: one with a thrust that lags, others pushed by signals."""
    values, times = SIGNAL
    controlled = motor(sj.PID(ROTOR, sj.functions.Linear(3.0, 0.2), **GAINS), speed=100.0)
    ball = sj.Body(2.0, (1.0, 1.0, 1.0))
    along = {name: sj.Travel(("ground", name), (1.0, 0.0, 0.0)) for name in ("held", "drawn", "table")}
    forces = {
        "lag": _lag(3.0, 0.1),
        "hold": sj.forces.SampledActuator(along["held"], times, values),
        "lines": sj.forces.SampledActuator(along["drawn"], times, values, linear=True),
        "drive": sj.PID(WHEEL, 4.0, 0.3, 1.5, limits=LIMITS, tracking_time=0.05, of_rate=True, offset=0.01),
        "by table": sj.Actuator(along["table"], sj.functions.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0]), offset=0.25),
    }
    wheel = sj.Body(1.0, (0.01, 0.01, 0.02))
    bearing = sj.Revolute(("ground", "wheel"), point=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    bodies = {**controlled.bodies, "wheel": wheel, "ball": ball, "held": ball, "drawn": ball, "table": ball}
    forces["motor"] = controlled.forces["motor"]  # without its spring, which counts one turn
    joints = {**controlled.joints, "axle": bearing}
    scene = sj.Scene(bodies, joints, forces, gravity=(0.0, 0.0, 0.0))
    return sj.simulate(scene, TS, rtol=1e-11)


def test_pid_in_continuous_time_through_many_turns(many):
    wanted = continuous_answer(TS, (0.2, 3.0), 0.02, 100.0)
    assert np.abs(wanted[:, 0]).max() > 2 * np.pi  # where the angle of a `Turn` by itself jumps
    kept, found = many.memory("motor"), many.force("motor")
    seen = [found["position"], found["rate"], kept["integral"], kept["filtered"], found["effort"]]
    np.testing.assert_allclose(np.column_stack(seen), wanted, atol=1e-7)


def test_force_with_a_state_of_its_own(many):
    built_up = 3.0 * (1 - np.exp(-TS / 0.1))
    np.testing.assert_allclose(many.memory("lag")["thrust"], built_up, atol=1e-7)
    np.testing.assert_allclose(many.force("lag")["force"], built_up, atol=1e-7)
    height = 1.5 * (TS**2 / 2 - 0.1 * TS + 0.01 * (1 - np.exp(-TS / 0.1)))
    np.testing.assert_allclose(many.position("ball")[:, 2], height, atol=1e-9)


def test_signals_are_held_or_drawn_as_lines(many):
    values, times = SIGNAL
    before = np.searchsorted(times, TS + 1e-12, side="right")
    held = np.where(before == 0, 0.0, values[np.maximum(before - 1, 0)])
    np.testing.assert_array_equal(many.force("hold")["effort"], held)
    lines = np.where(times[0] <= TS, np.interp(TS, times, values), 0.0)
    np.testing.assert_allclose(many.force("lines")["effort"], lines, atol=1e-13)
    for name, law in (("held", _held), ("drawn", _drawn), ("table", _by_table)):
        np.testing.assert_allclose(many.position(name)[-1, 0], _double_integral(law) / 2.0, atol=1e-9)


def _held(t):
    values, times = SIGNAL
    return values[np.searchsorted(times, t, side="right") - 1] if t >= times[0] else 0.0


def _drawn(t):
    return np.interp(t, SIGNAL[1], SIGNAL[0]) if t >= SIGNAL[1][0] else 0.0


def _by_table(t):
    return 0.25 + np.interp(t, [0.0, 0.5, 1.0], [0.0, 1.0, 0.0])


def _double_integral(law) -> float:
    """Of a law in pieces over a second: SciPy, restarted where pieces begin."""
    y = np.zeros(2)
    marks = sorted({0.0, 0.5, 1.0, *SIGNAL[1]})
    for start, end in itertools.pairwise(marks):
        shift = 1e-13 * (end - start)
        done = solve_ivp(
            lambda t, y, end=end, shift=shift: [y[1], law(min(t, end - shift))], (start, end), y, rtol=1e-12, atol=1e-14
        )
        y = done.y[:, -1]
    return float(y[0])


def test_memory_is_in_tables(many):
    table = many.to_xarray()
    np.testing.assert_array_equal(table["motor.integral"], many.memory("motor")["integral"])
    assert table["motor.integral"].attrs["units"] == "N m"
    assert table["lag.thrust"].attrs["units"] == "N"
    assert "joint_memory" not in table
    assert many.memory("bearing") == {}
    with pytest.raises(sj.SceneError, match="no joint 'moter'"):
        many.memory("moter")


def test_rates_are_controlled_and_limits_hold(many):
    """A speed controller with clipped torque, and anti-windup, against SciPy on the equation by hand."""

    def by_hand(t, y):
        asked = 0.3 * (4.0 - y[0]) + y[1] + 0.01
        torque = np.clip(asked, *LIMITS)
        return [torque / 0.02, 1.5 * (4.0 - y[0]) + (torque - asked) / 0.05]

    wanted = solve_ivp(by_hand, (0.0, 1.0), [0.0, 0.0], "DOP853", TS, rtol=1e-11, atol=1e-13, max_step=1e-3).y
    np.testing.assert_allclose(many.force("drive")["rate"], wanted[0], atol=1e-7)
    np.testing.assert_allclose(many.memory("drive")["integral"], wanted[1], atol=1e-6)
    efforts = np.asarray(many.force("drive")["effort"])
    assert efforts.max() == 0.15
    assert np.sum(efforts == 0.15) > 5
    assert efforts.min() > LIMITS[0]


def test_smooth_limits():
    control = sj.PID(ROTOR, 1.5, 0.8, limits=(-0.2, 0.6), smooth_limits=True)
    system = compile_scene(motor(control)).system
    structure, theta = flatten_system(system)
    y = np.zeros(system.layout.size)
    y[3] = 1.0
    rate = program_for(state_rate, structure).compute(theta, 0.0, y)
    asked = 0.8 * 1.5
    torque = 0.2 + 0.4 * np.tanh((asked - 0.2) / 0.4)
    np.testing.assert_allclose(rate[system.layout.n_position + 5], torque / 0.02, rtol=1e-12)


# Linearization, networks, files, errors -------------------------------------------------------------------------------


def test_poles_of_the_closed_loop():
    """The poles of the linear system are those of the plant with the controller; that it turns is no state."""
    scene = motor(sj.PID(ROTOR, 0.0, **GAINS), speed=0.0)
    found = sj.linearize(scene, inputs="forces.motor.offset", outputs=["motor.position"])
    kp, ki, kd, time = (GAINS[name] for name in ("proportional", "integral", "derivative", "filter_time"))
    A = np.zeros((4, 4))
    A[0, 1] = 1
    A[1] = np.array([-kp - kd / time - 0.3, -0.02, 1.0, -kd / time]) / 0.02
    A[2, 0], A[3, 0], A[3, 3] = -ki, -1 / time, -1 / time
    assert found.states == ("x1", "u1", "motor.integral", "motor.filtered")
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(found.A)), np.sort_complex(np.linalg.eigvals(A)))
    response = found.C @ np.linalg.solve(2j * np.eye(4) - found.A, found.B)
    by_hand = np.linalg.solve(2j * np.eye(4) - A, np.array([0.0, 1 / 0.02, 0.0, 0.0]))[0]
    np.testing.assert_allclose(response[0, 0], by_hand, rtol=1e-10)


def test_linearization_says_that_samples_are_held():
    with pytest.warns(sj.errors.LinearizationWarning, match="'motor' samples"):
        sj.linearize(sampled_motor(0.01))


def test_rest_of_states_is_not_guessed():
    with pytest.raises(sj.SceneError, match="force 'motor' has states of its own"):
        sj.equilibrium(motor(sj.PID(ROTOR, 0.0, **GAINS)))


def test_fast_filters_are_found():
    fast, slow = (
        choose_solver(compile_scene(motor(sj.PID(ROTOR, 0.0, 0.8, None, 0.05, filter_time=time))).system)
        for time in (1e-9, 1e-2)
    )
    assert fast.reason.startswith("Rodas5P: the states of force element 'motor' change at about 1.0e+09 per second")
    assert slow.reason.startswith("Dopri8")


# A controller that remembers nothing ---------------------------------------------------------------------------------

PLAIN = {
    "extension": sj.Extension(("ground.anchor", "rotor")),
    "travel": sj.Travel(("ground", "rotor"), (1.0, 0.0, 0.0)),
    "turn": sj.Turn(("ground", "rotor"), (1.0, 0.0, 0.0)),
}


def _on_a_rail(coordinate: str, proportional: Any = 8.0) -> sj.Scene:
    """A body that slides along x and turns about it, held at 0.2 m or rad: of mass and moment of inertia 2."""
    rotor = sj.Body(2.0, (2.0, 2.0, 2.0), position=(0.5, 0.0, 0.0))
    rail = sj.Cylindrical(("ground", "rotor"), point=(0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0))
    control = sj.PID(PLAIN[coordinate], 0.2, proportional, derivative=2.0)
    anchor = {"anchor": (0.0, 0.0, 0.0)}
    return sj.Scene({"rotor": rotor}, {"rail": rail}, {"motor": control}, gravity=(0, 0, 0), ground_points=anchor)


def _held_at(ts, proportional: float = 8.0) -> np.ndarray:
    """2 x'' = k (0.2 - x) - 2 x' from rest, in closed form."""
    w = np.sqrt(proportional / 2.0 - 0.25)
    return 0.2 - 0.2 * np.exp(-0.5 * ts) * (np.cos(w * ts) + 0.5 / w * np.sin(w * ts))


def test_a_controller_of_a_turn_without_integral_has_a_rest():
    rest = sj.equilibrium(_on_a_rail("turn")).scene.bodies["rotor"]
    np.testing.assert_allclose(rest.quaternion, [np.cos(0.1), np.sin(0.1), 0.0, 0.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("coordinate", sorted(PLAIN))
def test_a_controller_without_integral_and_filter_is_a_law(coordinate, tmp_path):
    """It runs, is written and read, comes to rest, and is linearized, along every coordinate."""
    scene, ts = _on_a_rail(coordinate), np.linspace(0.0, 1.0, 5)
    path = tmp_path / "rail.toml"
    sj.save_scene(scene, path)
    again = sj.load_scene(path)
    assert eqx.tree_equal(again, scene)
    run = sj.simulate(again, ts, rtol=1e-10)
    np.testing.assert_allclose(run.force("motor")["position"], _held_at(ts), atol=1e-9)
    rest = sj.simulate(sj.equilibrium(scene).scene, [0.0, 0.1], rtol=1e-10)
    np.testing.assert_allclose(rest.force("motor")["effort"], 0.0, atol=1e-9)
    poles = np.linalg.eigvals(sj.linearize(scene).A)
    wanted = np.roots([2.0, 2.0, 8.0])
    assert min(abs(poles - wanted[0])) < 1e-9
    assert min(abs(poles - wanted[1])) < 1e-9


@pytest.mark.slow
def test_a_controller_without_memory_in_lanes_and_derivatives():
    ts, gains = np.array([0.0, 0.6]), jnp.array([6.0, 8.0])

    @jax.jit
    def end(gain):
        return sj.simulate(_on_a_rail("extension", gain), ts, rtol=1e-10).force("motor")["position"][-1]

    np.testing.assert_allclose(jax.vmap(end)(gains), [_held_at(0.6, 6.0), _held_at(0.6)], atol=1e-9)
    slope = (_held_at(0.6, 8.0 + 1e-4) - _held_at(0.6, 8.0 - 1e-4)) / 2e-4
    np.testing.assert_allclose(jax.grad(end)(8.0), slope, rtol=1e-6)


def test_an_element_that_remembers_says_so_when_it_is_asked_for_wrenches():
    placed = compile_scene(_on_a_rail("extension")).system.forces["motor"]
    motions: Any = {name: body_motions_at_start(name) for name in ("ground", "rotor")}
    np.testing.assert_allclose(placed.wrenches(jnp.zeros(()), motions)["rotor"].force, [1.6, 0.0, 0.0], atol=1e-12)
    with pytest.raises(TypeError, match="remembers"):
        sj.PID(PLAIN["travel"], 0.2, integral=1.0).wrenches(jnp.zeros(()), motions)


def body_motions_at_start(name: str) -> BodyMotion:
    """At rest, the rotor at 0.5 m."""
    place = jnp.array([0.5 if name == "rotor" else 0.0, 0.0, 0.0])
    return BodyMotion(place, jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.eye(3), jnp.zeros(3), jnp.zeros(3))


def _network(activation) -> sj.Network:
    return sj.Network(eqx.nn.MLP(2, "scalar", 4, 1, activation=activation, key=jax.random.key(1)))


def _pushed(force: sj.forces.AbstractForce) -> sj.Scene:
    return sj.Scene({"ball": sj.Body(1.0, (1, 1, 1), position=(0.5, 0, 0))}, forces={"law": force}, gravity=(0, 0, 0))


def test_network_is_a_scalar_program_or_says_so():
    network = _network(jnp.tanh)
    assert all(eqx.is_inexact_array(leaf) for leaf in jax.tree.leaves(network))
    place = jnp.array([0.3, -0.2])
    np.testing.assert_array_equal(network(place), network.module(place))
    structure, theta = flatten_system(compile_scene(_pushed(NeuralForce(network))).system)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        program = program_for(state_rate, structure)
    assert program.scalar is not None
    y = np.zeros(14)
    y[:4], y[7] = (0.5, 0.0, 0.0, 1.0), 0.7
    np.testing.assert_allclose(program.compute(theta, 0.0, y)[7], network(jnp.array([0.5, 0.7])), rtol=1e-13)


def test_neural_law_with_a_derivative_rule_of_its_own_keeps_the_scalar_program():
    structure, theta = flatten_system(compile_scene(_pushed(NeuralForce(_network(jax.nn.relu)))).system)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        program = program_for(state_rate, structure)
    assert program.scalar is not None
    y = jnp.zeros(14).at[jnp.array([0, 1, 3, 7])].set(jnp.array([0.5, 0.1, 1.0, 0.7]))
    for way in (jax.jacfwd, jax.jacrev):
        by_scalars = way(lambda y: program(jnp.asarray(theta), 0.0, y))(y)
        by_arrays = way(lambda y: state_rate(structure.system(jnp.asarray(theta)), 0.0, y))(y)
        assert by_arrays[7, 0] != 0
        np.testing.assert_allclose(by_scalars, by_arrays, rtol=1e-12, atol=1e-12)


class Lookup(eqx.Module):
    """Entries of a table, of which indices, a mask and a random key say which and how."""

    table: jax.Array
    indices: jax.Array
    mask: jax.Array
    key: jax.Array

    def __call__(self, place):
        signs = jax.random.rademacher(self.key, self.table.shape, dtype=self.table.dtype)
        return -place[0] * (jnp.sum(self.table[self.indices]) + jnp.sum(jnp.where(self.mask, signs * self.table, 0.0)))


def _lookup(*indices: int) -> Lookup:
    return Lookup(jnp.arange(1.0, 7.0), jnp.array(indices), jnp.arange(6) < 3, jax.random.key(2))


def _end_of_push(module: eqx.Module) -> jax.Array:
    scene = _pushed(NeuralForce(sj.Network(module)))
    return sj.simulate(scene, np.array([0.0, 0.3]), rtol=1e-10).position("ball")[-1, 0]


def _end_on_spring(module: Lookup) -> np.ndarray:
    return 0.5 * np.cos(0.3 * np.sqrt(-float(module(jnp.array([1.0, 0.0])))))


def test_indices_masks_and_keys_of_a_network_are_structure_by_value():
    """They were compared as arrays, which ended in an error of JAX about pytrees as soon as two were looked at."""
    one, other = _lookup(3, 5, 5), _lookup(1, 2, 4)
    assert jax.tree.structure(sj.Network(one)) == jax.tree.structure(sj.Network(_lookup(3, 5, 5)))
    assert jax.tree.structure(sj.Network(one)) != jax.tree.structure(sj.Network(other))
    place = jnp.array([0.3, -0.2])
    for module in (one, other):
        np.testing.assert_array_equal(sj.Network(module)(place), module(place))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::spherejax.errors.ArrayPathWarning")
def test_indices_masks_and_keys_of_a_network_may_be_traced():
    """As `equinox.filter_jit` traces all arrays of a module; one program serves all of their values."""
    end = eqx.filter_jit(_end_of_push)
    slope = eqx.filter_jit(eqx.filter_grad(_end_of_push))
    for module in (_lookup(3, 5, 5), _lookup(1, 2, 4)):
        np.testing.assert_allclose([_end_of_push(module), end(module)], _end_on_spring(module), rtol=1e-8)
        gradient = slope(module)
        assert gradient.indices is None
        ahead, back = (
            _end_on_spring(eqx.tree_at(lambda lookup: lookup.table, module, module.table.at[1].add(h)))
            for h in (1e-5, -1e-5)
        )
        np.testing.assert_allclose(gradient.table[1], (ahead - back) / 2e-5, rtol=1e-6)


class Spectral(eqx.Module):
    """The real part of a complex stiffness times i."""

    stiffness: jax.Array

    def __call__(self, place):
        return jnp.real(1j * self.stiffness) * place[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::spherejax.errors.ArrayPathWarning")
def test_complex_numbers_of_a_network_keep_their_imaginary_parts():
    """They lost them, with a warning of NumPy alone, and none within `jax.jit`."""
    stiffness = jnp.array(3.0 + 4.0j)
    np.testing.assert_allclose(_end_of_push(Spectral(stiffness)), 0.5 * np.cos(0.6), rtol=1e-8)
    slope = jax.jit(jax.grad(lambda stiffness: _end_of_push(Spectral(stiffness))))(stiffness)
    # JAX's gradient by x + iy is d/dx - i d/dy.
    np.testing.assert_allclose(slope, 1j * 0.5 * np.sin(0.6) * 0.3 / 4.0, rtol=1e-6, atol=1e-9)


def test_complex_numbers_of_a_part_are_refused():
    class Own(NeuralForce):
        gain: jax.Array

    force = Own(_network(jnp.tanh), jnp.array(1.0 + 2.0j))
    with pytest.raises(sj.errors.SceneError, match=r"force 'law' .* holds complex numbers"):
        sj.simulate(_pushed(force), np.array([0.0, 0.1]))


NOISE_KEY = jax.random.key(5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::spherejax.errors.ArrayPathWarning")
def test_a_force_may_draw_by_a_random_key_that_it_looks_up():
    """The key is a constant of its program, of a type that NumPy has no arrays of."""

    def force(t, motions):
        return -jax.random.uniform(NOISE_KEY, (3,)) * motions["ball"].position

    run = sj.simulate(_pushed(sj.AppliedWrench("ball", force)), np.array([0.0, 0.3]), rtol=1e-10)
    drawn = float(jax.random.uniform(NOISE_KEY, (3,))[0])
    np.testing.assert_allclose(run.position("ball")[-1, 0], 0.5 * np.cos(0.3 * np.sqrt(drawn)), rtol=1e-8)


@pytest.mark.slow
def test_neural_law_is_trained_through_the_simulator():
    """Gradients by all of its numbers agree with differences, and a few steps along them fit a stiffening spring."""
    import optax

    def duffing(t, motions):
        x, v = motions["ball"].position[0], motions["ball"].velocity[0]
        return jnp.stack([-4 * x - 8 * x**3 - 0.3 * v, 0.0 * x, 0.0 * x])

    ts = np.linspace(0.0, 3.0, 31)
    measured = sj.simulate(_pushed(sj.AppliedWrench("ball", duffing)), ts).position("ball")[:, 0]

    @jax.jit
    def loss(network):
        places = sj.simulate(_pushed(NeuralForce(network)), ts, rtol=1e-7).position("ball")[:, 0]
        return jnp.mean((places - measured) ** 2)

    network: Any = _network(jnp.tanh)
    value_and_grad = jax.jit(jax.value_and_grad(loss))
    first, slope = value_and_grad(network)
    flat, unflatten = ravel_pytree(network)
    along = np.random.default_rng(0).normal(size=flat.size)
    difference = (loss(unflatten(flat + 1e-5 * along)) - loss(unflatten(flat - 1e-5 * along))) / 2e-5
    np.testing.assert_allclose(ravel_pytree(slope)[0] @ along, difference, rtol=1e-5)
    optimizer = optax.adam(0.05)
    state = optimizer.init(network)
    for _ in range(80):
        _, slope = value_and_grad(network)
        updates, state = optimizer.update(slope, state)
        network = optax.apply_updates(network, updates)
    assert float(loss(network)) < 0.05 * float(first)


MOTORS = """
kind = "sampled-pid"
coordinate = { kind = "turn", bodies = ["ground", "rotor"], axis = [0, 0, 1] }
period = "10 ms"
reference = { kind = "step", at = 0.1, before = 0.0, after = 1.5 }
proportional = 0.8
integral = 2.0
limits = ["-2 N m", "2 N m"]
tracking_time = "0.1 s"

[forces.shaker]
kind = "sampled-actuator"
coordinate = { kind = "travel", ends = ["ground", "rotor"], direction = [1, 0, 0] }
times = [0.0, 0.1]
values = ["1 kN", "0 N"]
"""


def test_controllers_in_files(tmp_path):
    path = tmp_path / "motor.toml"
    path.write_text(ROTOR_FILE + MOTORS)
    scene = sj.load_scene(path)
    control: Any = scene.forces["motor"]
    shaker: Any = scene.forces["shaker"]
    assert (control.period, control.proportional, control.tracking_time) == (0.01, 0.8, 0.1)
    np.testing.assert_array_equal(control.limits, [-2.0, 2.0])
    np.testing.assert_array_equal(shaker.values, [1000.0, 0.0])
    pid = sj.PID(sj.Extension(("ground", "rotor")), sj.functions.Sine(0.1, 2.0), 3.0, filter_time=0.1, derivative=1.0)
    whole = sj.Scene(scene.bodies, scene.joints, {**scene.forces, "push": pid}, gravity=scene.gravity)
    again = tmp_path / "again.toml"
    sj.save_scene(whole, again)
    assert eqx.tree_equal(sj.load_scene(again), whole)


ALONG = sj.Travel(("ground", "rotor"), (1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (lambda: sj.forces.SampledPID(ROTOR, 0.0), "period = 0 .*positive"),
        (lambda: sj.forces.SampledPID(ROTOR, 0.01, first_sample=np.nan), "first_sample"),
        (lambda: sj.PID(ROTOR, limits=(1.0, -1.0)), "limits .*increase"),
        (lambda: sj.PID(ROTOR, limits=(1.0, 2.0, 3.0)), "limits .*two numbers"),
        (lambda: sj.PID(ROTOR, tracking_time=0.1), "tracking_time .*limits and an integral"),
        (lambda: sj.PID(ROTOR, derivative=1.0, of_rate=True), "filter_time .*rate of a rate"),
        (lambda: sj.PID(ROTOR, filter_time=-1.0, derivative=1.0), "filter_time"),
        (lambda: sj.forces.SampledActuator(ALONG, [0.0, 0.0], [1.0, 2.0]), "times .*increase"),
        (lambda: sj.forces.SampledActuator(ALONG, [0.0, 1.0], [1.0]), "times .*as many as values"),
        (lambda: sj.Actuator(sj.Extension(("rotor", "rotor.x"))), "two bodies"),
    ],
)
def test_bad_controllers_say_so(force, words):
    with pytest.raises(sj.SceneError, match=words):
        compile_scene(motor(force()))


def test_scenes_without_samples_have_no_trace_of_them():
    structure, _ = flatten_system(compile_scene(motor(sj.PID(ROTOR, 0.0, **GAINS))).system)
    assert samples_of(structure, None) is None
    plain = compile_scene(sj.gallery.four_bar()).system
    assert plain.force_slots == ()
    assert plain.layout.n_memory == 0
    assert plain.forces_with(jnp.zeros(0)) is plain.forces
