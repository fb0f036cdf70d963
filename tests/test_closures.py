"""Functions of a user's own that close over a parameter: under `jit`, `grad`, `vmap`, in sweeps and fits.

Wherever a plain function enters a scene, what it closes over may be traced. It is then a number of the scene.
"""

import functools
import types
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.physics.functions.closures import closure_converted
from spherejax.program_cache.fingerprints import own_parts, reaches_tracer

TS = np.linspace(0.0, 0.5, 6)
X = 0.7


# Kinds of functions ---------------------------------------------------------------------------------------------------


class OfModule(eqx.Module):
    """A module whose method is handed over."""

    strength: Any
    name: str = eqx.field(static=True, default="module")

    def law(self, x):
        return self.strength * jnp.sin(x)


class WithFunction(eqx.Module):
    """A module that holds a function among its numbers."""

    function: Any
    scale: Any

    def __call__(self, x):
        return self.scale * self.function(x)


class Plain:
    """An object that can be called."""

    def __init__(self, strength):
        self.strength = strength

    def __call__(self, x):
        return self.strength * jnp.sin(x)

    def law(self, x):
        return self.strength * jnp.sin(x)


class OwnFunction(sj.functions.AbstractFunction):
    """A function with a static part."""

    law: Any = eqx.field(static=True)

    def __call__(self, x):
        return self.law(x)


def nested(a):
    def inner(x):
        return a * jnp.sin(x)

    def outer(x):
        return inner(x)

    return lambda x: outer(x)


def recursive(a):
    def law(x, n=2):
        return a * jnp.sin(x) if n == 0 else law(x, n - 1)

    return law


def with_rule(a):
    @jax.custom_jvp
    def law(strength, x):
        return strength * jnp.sin(x)

    law.defjvp(lambda primals, tangents: (
        law(*primals), tangents[0] * jnp.sin(primals[1]) + primals[0] * jnp.cos(primals[1]) * tangents[1],
    ))  # fmt: skip
    return lambda x: law(a, x)


def of_default(a):
    return lambda x, strength=a: strength * jnp.sin(x)


def of_keyword(a):
    def law(x, *, strength=a):
        return strength * jnp.sin(x)

    return law


FUNCTIONS: dict[str, Callable[[Any], Callable]] = {
    "closure": lambda a: lambda x: a * jnp.sin(x),
    "default argument": of_default,
    "keyword": of_keyword,
    "partial": lambda a: functools.partial(lambda strength, x: strength * jnp.sin(x), a),
    "partial of a keyword": lambda a: functools.partial(lambda x, strength: strength * jnp.sin(x), strength=a),
    "partial of a pytree": lambda a: jax.tree_util.Partial(lambda strength, x: strength * jnp.sin(x), a),
    "nested closures": nested,
    "recursion": recursive,
    "in a list and a dict": lambda a: (lambda box: lambda x: box["all"][1] * jnp.sin(x))({"all": [1.0, a], "n": "two"}),
    "namespace": lambda a: (lambda box: lambda x: box.a * jnp.sin(x))(types.SimpleNamespace(a=a, word="b")),
    "entry of an array": lambda a: (lambda p: lambda x: p[1] * jnp.sin(x))(jnp.stack([2.0 * a, a])),
    "whole number": lambda a: (lambda k: lambda x: a * jnp.asarray([9.0, 1.0, 9.0])[k] * jnp.sin(x))(
        jnp.asarray(a / a, jnp.int32)
    ),
    "complex": lambda a: (lambda c: lambda x: (c * jnp.exp(1j * x)).imag)(a + 0j),
    "jitted": lambda a: jax.jit(lambda x: a * jnp.sin(x)),
    "vmapped": lambda a: lambda x: jax.vmap(lambda y: a * jnp.sin(y))(jnp.stack([x]))[0],
    "a derivative": lambda a: jax.grad(lambda x: -a * jnp.cos(x)),
    "own rule of derivatives": with_rule,
    "method": lambda a: Plain(a).law,
    "object": Plain,
    "method of a module": lambda a: OfModule(a).law,
    "module in a closure": lambda a: (lambda m: lambda x: m.law(x))(OfModule(a)),
    "module with a function": lambda a: WithFunction(lambda x: a * jnp.sin(x), jnp.asarray(1.0)),
    "own class with a static function": lambda a: OwnFunction(lambda x: a * jnp.sin(x)),
    "table": lambda a: sj.functions.SmoothTable([0.0, X, 1.0], jnp.stack([0.0, 1.0, 2.0]) * a * np.sin(X)),
}


def wrapped(function: Any) -> sj.functions.AbstractFunction:
    """A function as a scene takes it."""
    return sj.functions.Sum(function, sj.functions.Constant(0.0))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_a_function_closes_over_is_a_number_of_the_scene(name):
    held = []

    def numbers(a):
        function = wrapped(FUNCTIONS[name](a))
        leaves, structure = jax.tree.flatten(function)
        held.append(structure)
        return leaves

    leaves = jax.jit(numbers)(2.0)
    structure = held[-1]
    assert not reaches_tracer(own_parts(structure))
    # After the trace has ended, with its numbers and with others.
    assert jax.tree.unflatten(structure, leaves)(X) == pytest.approx(2.0 * np.sin(X), rel=1e-14)
    others = jax.jit(numbers)(3.0)
    assert jax.tree.unflatten(structure, others)(X) == pytest.approx(3.0 * np.sin(X), rel=1e-14)
    both = jax.vmap(lambda a: wrapped(FUNCTIONS[name](a))(X))(jnp.array([2.0, 3.0]))
    np.testing.assert_allclose(both, np.array([2.0, 3.0]) * np.sin(X), rtol=1e-14)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "table"])
def test_numbers_that_are_known_stay_in_the_function(name):
    """A known number may decide a branch, and costs no entry in the numbers of the scene."""
    if name not in ("entry of an array", "whole number", "complex"):  # these make JAX arrays of it
        assert closure_converted(FUNCTIONS[name](2.0)) is None
    assert wrapped(FUNCTIONS[name](2.0))(X) == pytest.approx(2.0 * np.sin(X), rel=1e-14)


def test_a_random_key_in_a_function():
    def at(seed):
        key = jax.random.key(seed)
        return wrapped(lambda x: jax.random.normal(key) * x)(2.0)

    assert jax.jit(at)(5) == 2.0 * jax.random.normal(jax.random.key(5))


def test_a_closure_written_anew_is_the_same_structure():
    """A builder writes its functions anew in each call: other numbers are no other program, other code is."""

    def structure(function, a, *arguments):
        held = []
        jax.make_jaxpr(lambda a: held.append(jax.tree.structure(wrapped(function(a, *arguments)))))(a)
        return held[0]

    def first(a, power=1, helper=lambda x: x, table=None):
        return lambda x: a * helper(x) ** power + (0.0 if table is None else table[0])

    def second(a):
        return lambda x: a + x

    one = structure(first, 1.0)
    assert one == structure(first, 2.0)
    assert hash(one) == hash(structure(first, 2.0))
    assert one != structure(second, 1.0)
    assert one != structure(first, 1.0, 2) != structure(first, 1.0, 2.0)
    assert structure(first, 1.0, 1, lambda x: x) != structure(first, 1.0, 1, lambda x: 2 * x)
    ones, twos = np.ones(2), np.full(2, 2.0)
    assert structure(first, 1.0, 1, len, ones) == structure(first, 1.0, 1, len, np.ones(2))
    assert structure(first, 1.0, 1, len, ones) != structure(first, 1.0, 1, len, twos)
    before = structure(first, 1.0, 1, len, ones)
    ones[0] = 5.0  # what is written into an array later makes another one
    assert before != structure(first, 1.0, 1, len, np.ones(2))


# Places where functions enter -----------------------------------------------------------------------------------------

BALL = sj.Body(1.0, [0.02] * 3, position=(0.3, 0.0, 0.2), velocity=(0.1, 0.0, 0.4), points={"eye": (0.0, 0.0, 0.05)})
ENDS = ("ground", "ball")
ALONG = sj.Extension(ENDS)
UP = (0.0, 0.0, 1.0)


def pushed(part: sj.forces.AbstractForce) -> sj.Scene:
    """A free ball and a force element."""
    return sj.Scene({"ball": BALL}, forces={"it": part}, gravity=(0.0, 0.0, 0.0))


def joined(part: sj.joints.AbstractJoint, at=(0.0, 0.0, 0.0), speed=(0.0, 0.0, 0.0)) -> sj.Scene:
    """A ball on a joint."""
    ball = sj.Body(1.0, [0.02] * 3, position=at, velocity=speed, points={"eye": (0.0, 0.0, 0.0)})
    return sj.Scene({"ball": ball}, {"it": part}, ground_points={"o": (0.0, 0.0, 0.0)})


def two_slopes(a) -> sj.functions.AbstractFunction:
    """A function that is made of functions."""
    pieces: Any = [lambda v: a * v, lambda v: 2 * a * v]
    return sj.functions.Piecewise([0.0], pieces)


PLACES: dict[str, Callable[[Any], sj.Scene]] = {
    "spring": lambda a: pushed(sj.SpringDamper(ENDS, spring=lambda u: a * u**3)),
    "damper": lambda a: pushed(sj.SpringDamper(ENDS, damper=lambda v: a * jnp.arctan(100 * v))),
    "law": lambda a: pushed(sj.SpringDamper(ENDS, law=lambda length, rate, t: a * length * rate + t)),
    "shock absorber": lambda a: pushed(sj.forces.ShockAbsorber(ENDS, lambda v: a * v, lambda v: 2 * a * v)),
    "torsional spring": lambda a: pushed(sj.TorsionalSpring(ENDS, UP, spring=lambda q: a * (q + 0.1))),
    "bump stop": lambda a: pushed(sj.forces.BumpStop(ENDS, longest=0.1, spring=lambda u: a * u, stiffness=1.0)),
    "actuator": lambda a: pushed(sj.Actuator(ALONG, lambda t: a * (t + 1))),
    "push": lambda a: pushed(sj.AppliedWrench("ball", lambda t: jnp.stack([0.0 * t, a + t, 0.0 * t]))),
    "push by state": lambda a: pushed(sj.AppliedWrench("ball", lambda t, motions: -a * motions["ball"].velocity)),
    "moment": lambda a: pushed(sj.AppliedWrench("ball", moment=lambda t: a * jnp.stack([t + 1, t, t]))),
    "controller": lambda a: pushed(sj.PID(ALONG, lambda t: a * (t + 1), 3.0)),
    "sampled controller": lambda a: pushed(sj.forces.SampledPID(ALONG, 0.01, lambda t: a * (t + 1), 3.0)),
    "road": lambda a: pushed(sj.forces.Tyre("ball.eye", 0.8, 2e3, road=lambda x, t: a * x + 0.1 * t)),
    "pieces": lambda a: pushed(sj.SpringDamper(ENDS, damper=two_slopes(a))),
    "driven angle": lambda a: joined(sj.RotationDriver(ENDS, UP, lambda t: a * (t + t**2))),
    "driven travel": lambda a: joined(sj.TranslationDriver(ENDS, "ball.eye", UP, lambda t: a * (t + t**2))),
    "driven point": lambda a: joined(sj.joints.PositionDriver("ball.eye", lambda t: a * jnp.stack([t, t**2, t]))),
    "driven length": lambda a: joined(
        sj.joints.DistanceDriver("ground.o", "ball.eye", lambda t: 0.5 + a * t**2), at=(0.5, 0.0, 0.0)
    ),
    "curve": lambda a: joined(
        sj.joints.PointOnCurve("ball.eye", sj.joints.ImplicitCurve(lambda p: jnp.stack([p[1], p[2] - a * p[0] ** 2]))),
        speed=(1.0, 0.0, 0.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_wherever_a_function_enters_it_may_close_over_a_parameter(place):
    """The equations of a scene that is built of a traced number are those of one that is built of a known one."""
    held = []

    def numbers(a):
        structure, theta = flatten_system(sj.equations.compile_scene(PLACES[place](a)).system)
        held.append(structure)
        return theta

    theta = jax.jit(numbers)(1.3)
    assert not reaches_tracer(own_parts(held[-1].tree))
    known = sj.equations.compile_scene(PLACES[place](1.3)).system
    y = np.linspace(0.1, 0.4, known.layout.size)
    y[:7] = [0.3, 0.1, 0.2, 1.0, 0.0, 0.0, 0.0]
    expected = jax.jit(lambda y: state_rate(known, jnp.asarray(0.2), y))(y)
    found = jax.jit(lambda theta, y: state_rate(held[-1].system(theta), jnp.asarray(0.2), y))(theta, y)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


# Runs -----------------------------------------------------------------------------------------------------------------


def rubbing(friction):
    """A ball on a spring along its line, with a damper of Coulomb's kind."""
    ball = sj.Body(1.0, [1e-3] * 3, position=(0.0, 0.0, 0.3), velocity=(0.0, 0.0, 1.0))
    damped = sj.SpringDamper(ENDS, 50.0, free_length=0.3, damper=lambda rate: friction * jnp.arctan(100.0 * rate))
    return sj.Scene({"ball": ball}, forces={"it": damped}, gravity=(0.0, 0.0, 0.0))


@functools.cache
def rubbed(friction: float) -> float:
    """Its height in the end, by SciPy."""
    from scipy.integrate import solve_ivp

    def rate(t, y):
        return [y[1], -50.0 * (y[0] - 0.3) - friction * np.arctan(100.0 * y[1])]

    return solve_ivp(rate, (0.0, 0.5), [0.3, 1.0], method="DOP853", rtol=1e-12, atol=1e-14).y[0, -1]


def slope(friction: float) -> float:
    """Of `rubbed`."""
    h = 1e-3
    return (rubbed(friction + h) - rubbed(friction - h)) / (2 * h)


ROADS: dict[str, dict] = {
    "scalar program": {},
    "array code": {"scalar": False},
    "Rosenbrock": {"solver": sj.solvers.Ros34PW2(), "rtol": 1e-10},
    "reverse through diffrax": {"adjoint": diffrax.RecursiveCheckpointAdjoint(), "max_steps": 4096},
}


@pytest.mark.parametrize("road", ROADS)
def test_derivatives_by_what_a_function_closes_over(road):
    def end(friction):
        return sj.simulate(rubbing(friction), TS, **ROADS[road]).position("ball")[-1, 2]

    value, backward = jax.value_and_grad(end)(2.0)
    assert value == pytest.approx(rubbed(2.0), abs=1e-7)
    assert backward == pytest.approx(slope(2.0), rel=1e-4)
    if road != "reverse through diffrax":
        np.testing.assert_allclose(jax.jvp(end, (2.0,), (1.0,)), (value, backward), rtol=1e-9)
        np.testing.assert_allclose(jax.vmap(end)(jnp.array([1.0, 2.0])), [rubbed(1.0), rubbed(2.0)], atol=1e-7)
        assert jax.jit(end)(1.0) == pytest.approx(rubbed(1.0), abs=1e-7)
        np.testing.assert_allclose(jax.jit(jax.grad(end))(2.0), backward, rtol=1e-9)


def test_the_scalar_program_is_kept():
    run = jax.jit(lambda friction: sj.simulate(rubbing(friction), TS))(2.0)
    assert run.scalar is not False
    assert "array" not in run.stats.explanation
    # What is observed of a run of a program that is over.
    assert np.all(np.isfinite(run.force("it")["force"]))


def turned(speed, swing):
    """An arm whose angle is prescribed by a function of two parameters."""
    arm = sj.Body(2.0, [0.02] * 3, position=(0.3, 0.0, 0.0), points={"pin": (-0.3, 0.0, 0.0)})
    pivot = sj.Revolute(("ground", "arm"), "arm.pin", UP)
    motor = sj.RotationDriver(("ground", "arm"), UP, lambda t: speed * t + swing * jnp.sin(3.0 * t))
    return sj.Scene({"arm": arm}, {"pivot": pivot, "motor": motor}, drift=sj.solvers.Projection())


def test_a_driver_that_closes_over_two_parameters():
    """The angle q = a t + b sin 3t is prescribed: y = 0.3 sin q, dy/da = 0.3 t cos q, dy/db = 0.3 sin 3t cos q."""

    def height(values):
        return sj.simulate(turned(*values), TS).position("arm")[-1, 1]

    values, t = jnp.array([2.0, 0.5]), TS[-1]
    q = values[0] * t + values[1] * np.sin(3 * t)
    exact = 0.3 * np.cos(q) * np.array([t, np.sin(3 * t)])
    assert height(values) == pytest.approx(0.3 * np.sin(q), abs=1e-8)
    np.testing.assert_allclose(jax.grad(height)(values), exact, rtol=1e-6)
    np.testing.assert_allclose(jax.jacfwd(height)(values), exact, rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(jax.grad(height))(jnp.stack([values, values])), [exact] * 2, rtol=1e-6)


FRICTIONS = np.array([0.5, 1.0, 2.0])


def test_many_runs():
    runs = sj.simulate_many(rubbing, {"friction": FRICTIONS}, TS, by=("friction",))
    ends = [rubbed(float(each)) for each in FRICTIONS]
    np.testing.assert_allclose(runs.trajectories.position("ball")[:, -1, 2], ends, atol=1e-7)
    assert runs.slopes is not None
    found = runs.slopes.ys[:, 0, -1, 2]
    np.testing.assert_allclose(found, [slope(float(each)) for each in FRICTIONS], rtol=1e-4)


def test_a_sweep():
    swept = sj.sweep(rubbing, {"friction": FRICTIONS}, jnp.asarray(TS), record=["final position.ball"], progress=False)
    found = np.asarray(swept["final_position.ball"])[:, 2]
    np.testing.assert_allclose(found, [rubbed(float(each)) for each in FRICTIONS], atol=1e-7)


def test_a_fit_and_a_sensitivity():
    run = sj.simulate(rubbing(1.5), TS)
    record = {"time": TS, "position.ball.z": np.asarray(run.position("ball"))[:, 2]}
    fitted = sj.fit(rubbing, {"friction": 1.0}, record, noise=1e-4, progress=False)
    assert fitted.estimates["friction"] == pytest.approx(1.5, rel=1e-6)
    found = sj.sensitivity(rubbing, {"friction": 2.0}, jnp.asarray(TS), observables=["position.ball.z"])
    last = found.to_xarray()["sensitivity.position.ball.z"].values[-1, 0]
    assert last == pytest.approx(slope(2.0), rel=1e-4)


# The values of now ----------------------------------------------------------------------------------------------------

GAIN = 1.0
TABLE = {"gain": 1.0}
HEARD: list[str] = []


def _heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        HEARD.append(event)


jax.monitoring.register_event_duration_secs_listener(_heard)


def by_global(t):
    return GAIN * t


def by_table(t):
    return TABLE["gain"] * t


def lifted(push, **options):
    """Height after 0.5 s of a mass of 1 kg from rest under a force of `push(t)`; t^3 / 6 for a force of t."""
    wrench = sj.AppliedWrench("ball", lambda t: jnp.stack([0.0 * t, 0.0 * t, push(t)]))
    scene = sj.Scene({"ball": sj.Body(1.0, [1e-3] * 3)}, forces={"it": wrench}, gravity=(0.0, 0.0, 0.0))
    return sj.simulate(scene, TS, **options).position("ball")[-1, 2]


def rising(gain):
    """The exact height for a force of gain t."""
    return pytest.approx(gain * TS[-1] ** 3 / 6, rel=1e-9)


def test_equal_code_with_other_values_is_answered_with_these():
    """Known values in closures, default arguments, containers, globals; what changes is seen."""
    global GAIN
    for gain in (1.0, 2.0):
        box, array = {"gain": gain}, np.array([0.0, gain])
        assert lifted(lambda t, gain=gain: gain * t) == rising(gain)
        assert lifted(lambda t, box=box: box["gain"] * t) == rising(gain)
        assert lifted(lambda t, array=array: array[1] * t) == rising(gain)
        GAIN = TABLE["gain"] = gain
        assert lifted(by_global) == rising(gain)
        assert lifted(by_table) == rising(gain)


@pytest.mark.parametrize("road", [{}, {"scalar": False}])
def test_what_stands_beside_a_traced_value_is_that_of_now(road):
    """The structure of a function that is written anew is found again, unless something else in it has changed."""
    global GAIN

    def end(gain, factor, array):
        return lifted(lambda t: GAIN * TABLE["gain"] * factor * array[1] * gain * t, **road)

    GAIN, TABLE["gain"], array = 1.0, 1.0, np.array([0.0, 1.0])

    def both(factor=1.0):
        value, slope = jax.value_and_grad(end)(2.0, factor, array)
        assert slope == pytest.approx(float(value) / 2.0, rel=1e-9)
        return value

    assert both() == rising(2.0)
    n = len(HEARD)
    assert both() == rising(2.0)
    assert len(HEARD) == n  # the lambda is another one, the program is not
    assert both(factor=3.0) == rising(6.0)
    array[1] = 5.0
    assert both() == rising(10.0)
    GAIN = 7.0
    assert both() == rising(70.0)
    TABLE["gain"] = 0.5
    assert both() == rising(35.0)
    array[1], GAIN, TABLE["gain"] = 1.0, 1.0, 1.0
    assert both() == rising(2.0)


def test_a_loop_over_values_compiles_once():
    def end(gain):
        return lifted(lambda t: gain * t)

    assert jax.value_and_grad(end)(1.0)[0] == rising(1.0)
    assert jax.jvp(end, (1.0,), (1.0,))[1] == rising(1.0)
    n = len(HEARD)
    for gain in (2.0, 3.0):
        assert jax.value_and_grad(end)(gain)[0] == rising(gain)
        assert jax.jvp(end, (gain,), (1.0,))[0] == rising(gain)
    assert len(HEARD) == n


# What cannot be taken out ---------------------------------------------------------------------------------------------


def test_a_class_that_holds_a_traced_value_is_named():
    """A class written within a builder is no function: the error names the force, the class and the remedy."""

    def end(gain):
        class Push(sj.forces.AbstractForce):
            @property
            def body_names(self):
                return ("ball",)

            def wrenches(self, t, motions):
                return {"ball": sj.forces.Wrench(jnp.stack([0.0 * t, 0.0 * t, gain * t]), jnp.zeros(3))}

        scene = sj.Scene({"ball": sj.Body(1.0, [1e-3] * 3)}, forces={"it": Push()}, gravity=(0.0, 0.0, 0.0))
        return sj.simulate(scene, TS, scalar=False).position("ball")[-1, 2]

    assert end(1.0) == rising(1.0)
    for transformed in (jax.jit(end), jax.grad(end), lambda x: jax.vmap(end)(jnp.stack([x, x]))):
        with pytest.raises(sj.SceneError, match=r"force 'it' \(Push\).*Push uses a value that JAX traces.*a field"):
            transformed(1.0)


@pytest.mark.filterwarnings("ignore:state_rate runs as array code")
def test_a_global_variable_that_is_traced_is_named():
    global GAIN

    def build(gain):
        global GAIN
        GAIN = gain
        wrench = sj.AppliedWrench("ball", lambda t: jnp.stack([0.0 * t, 0.0 * t, GAIN * t]))
        return sj.Scene({"ball": sj.Body(1.0, [1e-3] * 3)}, forces={"it": wrench}, gravity=(0.0, 0.0, 0.0))

    try:
        with pytest.raises(sj.SceneError, match=r"force 'it' \(AppliedWrench\).*global variable"):
            sj.simulate_many(build, {"gain": FRICTIONS}, TS)
    finally:
        GAIN = 1.0


def test_a_network_of_traced_numbers():
    """A network's activation stands among its arrays; with both traced the law is as by hand."""

    def network(scale):
        net = eqx.nn.MLP("scalar", "scalar", 3, 1, activation=lambda x: scale * jnp.tanh(x), key=jax.random.key(0))
        return eqx.tree_at(lambda net: net.layers[0].weight, net, replace_fn=lambda w: scale * w)

    def of_scene(scale):
        return wrapped(network(scale))(X)

    expected = network(2.0)(jnp.asarray(X))
    slope = jax.grad(lambda scale: network(scale)(jnp.asarray(X)))(2.0)
    assert jax.jit(of_scene)(2.0) == pytest.approx(float(expected), rel=1e-14)
    np.testing.assert_allclose(jax.jit(jax.value_and_grad(of_scene))(2.0), (expected, slope), rtol=1e-14)


def test_a_controller_without_states():
    """m z'' = -K z: a proportional controller has nothing to remember."""
    ball = sj.Body(1.0, [1e-3] * 3, position=(0.0, 0.0, 1.0))
    held = sj.PID(sj.Travel(("ground", "ball"), UP), -1.0, 9.0)  # a travel is zero at the start
    run = sj.simulate(sj.Scene({"ball": ball}, forces={"it": held}, gravity=(0.0, 0.0, 0.0)), TS)
    np.testing.assert_allclose(run.position("ball")[:, 2], np.cos(3 * TS), atol=1e-6)
    np.testing.assert_allclose(run.force("it")["effort"], -9 * np.cos(3 * TS), atol=1e-5)
