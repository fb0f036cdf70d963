"""Machine code for scalar programs: the numbers of the programs themselves, few kernels between calls, kept on disk.

`test_straight_line.py` tests every operation and transformation twice, once as machine code.
"""

import dataclasses
import functools
import os
import subprocess
import sys
from typing import Any, NamedTuple

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import core as jex
from jax.flatten_util import ravel_pytree

import spherejax as sj
from spherejax.compiler import primitive
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native import loop_fusion
from spherejax.compiler.native.loop_fusion import fuse_loops, whole_loops
from spherejax.compiler.operations import OPERATIONS
from spherejax.compiler.program import scalarize
from spherejax.compiler.runge_kutta import Tableau
from spherejax.foundations.lanes import in_lanes
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.lanes.stages import ExplicitStages
from spherejax.motion.integration.one_run import _with_slopes, advance_window, before_first_window, integrated
from spherejax.motion.integration.sensitivity_rows import linearized, rows_rate
from spherejax.motion.results.observed import observed
from spherejax.motion.start.assembly import as_ideal, assemble_now

pytestmark = pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")


@pytest.fixture
def small_ones_too(monkeypatch):
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)


def n_calls(function, *arguments) -> int:
    return jax.jit(function).lower(*arguments).as_text().count("stablehlo.custom_call @spherejax_")


@pytest.mark.parametrize("name", cases.MODELS)
def test_every_model_has_the_numbers_of_its_program(name, small_ones_too):
    """Against Python's arithmetic on the same graph; one lane, nineteen, and derivatives along three directions."""
    system = compile_scene(cases.ball_in_socket(cases.MODELS[name])).system
    structure, theta = flatten_system(system)
    rate = program_for(state_rate, structure)
    start = assemble_now(*flatten_system(as_ideal(system)))
    states = [cases.displaced_state(system, start, seed, 0.9 * cases.C) for seed in range(3)]
    ys = np.stack([*states, *(states[0] * (1 + 1e-3 * i) for i in range(16))])
    expected = np.stack([rate.compute(theta, 0.1, y) for y in ys])
    scale = 1 + np.abs(expected).max()
    with machine_code.native_code():
        assert n_calls(rate, theta, 0.1, ys[0]) == 1
        one = np.stack([jax.jit(rate)(theta, 0.1, y) for y in ys[:3]])
        many = jax.jit(jax.vmap(rate, (None, None, 0)))(theta, 0.1, ys)
        along = jax.jit(jax.vmap(lambda d: jax.jvp(lambda y: rate(theta, 0.1, y), (ys[0],), (d,))[1]))(ys[:3])
    np.testing.assert_allclose(one, expected[:3], rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(many, expected, rtol=1e-12, atol=1e-12 * scale)
    by_xla = jax.vmap(lambda d: jax.jvp(lambda y: rate(theta, 0.1, y), (ys[0],), (d,))[1])(ys[:3])
    np.testing.assert_allclose(along, by_xla, rtol=1e-11, atol=1e-11 * (1 + np.abs(by_xla).max()))


# Where there is none --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("version", lambda _: "0.99.1", r"it has not been tried with jaxlib 0\.99\.1"),
        ("version", lambda _: "0.6.1", r"with jaxlib 0\.6\.1"),
        ("llvmlite", None, r"llvmlite cannot be used \(ModuleNotFoundError"),
    ],
)
def test_an_installation_that_cannot_have_it_is_told_once(name, value, why, monkeypatch):
    afresh = functools.cache(machine_code.is_available.__wrapped__)
    if name == "version":
        monkeypatch.setattr(machine_code, "version", value)
    else:
        for module in [each for each in sys.modules if each.split(".")[0] == name]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, name, value)
    needed = "llvmlite" if name == "llvmlite" else "jax and jaxlib 0.10 to 0.12"
    remedy = f"Install {needed}, or set SPHEREJAX_MACHINE_CODE=0"
    with pytest.warns(sj.runtime.ConfigurationWarning, match=f"{why}.*{remedy}") as told:
        assert [afresh(), afresh()] == [False, False]
    assert len(told) == 1
    monkeypatch.setenv("SPHEREJAX_MACHINE_CODE", "0")
    assert not machine_code.is_available.__wrapped__()


# Between calls --------------------------------------------------------------------------------------------------------


def field(y):
    """Large enough for a call."""
    return jnp.stack([jnp.sin(y[0]) * y[1], jnp.cos(y[1]) - y[2] * y[0], jnp.tanh(y[0] * y[1]) - 0.1 * y[2]])


FIELD = scalarize(field, jnp.ones(3))


def wandering(rate, n=20):
    """Loops in loops, conditions, all types, arguments that come to nothing, samples, and what is none for a kernel."""

    def run(y, weights, counts, is_odd):
        def stage(k, row):
            change = rate(y + jnp.sum(row[:, None] * k, axis=0))
            return k + 0.1 * change, (change, k.sum())

        def turn(state):
            i, y, k, flag, found = state
            (k, (changes, sums)) = jax.lax.scan(stage, k, weights, reverse=True)
            y = y + 0.01 * rate(y) + 0.001 * changes[0] + 0 * jnp.zeros(0).sum()
            y = jax.lax.cond(flag, lambda y: y + 0.01 * rate(2 * y), lambda y: y * counts[0], y)
            y = y + 1e-3 * jnp.sort(y) + 1e-3 * jnp.linalg.solve(jnp.eye(3) + 0.1 * jnp.outer(y, y), y)
            y = y.at[jnp.array([0, 2, 0])].add(1e-3 * y) + jax.pure_callback(
                lambda x: 1e-3 * np.cos(x), y, y, vmap_method="sequential"
            )
            nothing = y * 0 + jnp.where(False, k[0], 0.0)
            return i + 1, y + nothing, k * 0.5, ~flag, found.at[i].set(y + sums[-1])

        start = (jnp.zeros((), jnp.int64), y, jnp.zeros((3, 3)), is_odd, jnp.zeros((n, 3)))
        return jax.lax.while_loop(lambda state: state[0] < n, turn, start)

    return run


ARGUMENTS = jnp.array([0.3, -0.7, 1.1]), 0.1 * jnp.arange(12.0).reshape(4, 3), jnp.array([1, 2]), jnp.array(True)


def test_loops_in_few_kernels_have_the_numbers_of_loops(small_ones_too):
    expected = jax.jit(wandering(field))(*ARGUMENTS)
    with machine_code.native_code():
        run = fuse_loops(wandering(FIELD))
        text = jax.jit(run).lower(*ARGUMENTS).as_text()
        found = jax.jit(run)(*ARGUMENTS)
        many = jax.jit(jax.vmap(run, (0, None, None, None)))(jnp.stack([ARGUMENTS[0]] * 2), *ARGUMENTS[1:])
    assert text.count("xla_cpu_small_call") >= 4
    assert text.count("stablehlo.custom_call @spherejax_") == 3
    for one, two, other in zip(found, many, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-12)
        np.testing.assert_allclose(two, np.stack([other] * 2), rtol=1e-12)


def test_a_loop_within_a_loop_takes_the_vectors_of_the_outer_one(small_ones_too):
    # Bits are not counted in machine code: with another condition both loops would be one call.
    def run(rate):
        def turn(state):
            i, y, flag, a, b = state
            return i + 1, y + 0.01 * rate(y), ~flag, a + y, b - a

        def stretch(state):
            i, *others = jax.lax.while_loop(lambda state: jax.lax.population_count(state[0] & 3) < 2, turn, state)
            _, y, flag, a, b = state = turn((i, *others))
            return state[0], y, flag, jnp.where(flag, a, b), b

        def until(n, y):
            start = jnp.zeros((), jnp.int64), y, jnp.array(True), y * 2, y - 1
            return jax.lax.while_loop(lambda state: state[0] < n, stretch, start)

        return until

    expected = jax.jit(run(field))(18, ARGUMENTS[0])
    with machine_code.native_code():
        made = jax.make_jaxpr(fuse_loops(run(FIELD)))(18, ARGUMENTS[0]).jaxpr
        found = jax.jit(fuse_loops(run(FIELD)))(18, ARGUMENTS[0])
    (outer,) = (equation for equation in made.eqns if equation.primitive.name == "while")
    body = outer.params["body_jaxpr"].jaxpr
    (inner,) = (equation for equation in body.eqns if equation.primitive.name == "while")
    assert set(body.invars) & set(inner.invars) >= {each for each in body.invars if each.aval.shape == (9,)} != set()
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-12)


def kernels(jaxpr):
    for equation in jaxpr.eqns:
        if equation.primitive.name == "loop_fusion":
            yield equation
        for inner in jex.jaxprs_in_params(equation.params):
            yield from kernels(inner)


@pytest.mark.parametrize("n", [20, 1000])
def test_what_a_loop_writes_down_is_not_copied_by_kernels(n, small_ones_too):
    with machine_code.native_code():
        found = [*kernels(jax.make_jaxpr(fuse_loops(wandering(FIELD, n)))(*ARGUMENTS).jaxpr)]
    assert found
    sizes = {out.aval.size for kernel in found for out in kernel.outvars}
    assert max(sizes) <= loop_fusion.LARGEST_JOINED


@pytest.mark.parametrize("kind", ["sum", "max", "all", "dot", "squares"])
@pytest.mark.parametrize("n", [4, 26, 121])
def test_large_sums_between_calls_are_left_to_xla(kind, n, small_ones_too):
    """To which a library makes them, and then it cannot write a kernel that has one."""
    reduced = {
        "sum": lambda x: jnp.sum(x, 1),
        "max": lambda x: jnp.max(x, 1),
        "all": lambda x: jnp.full(n, jnp.sum(x)),
        "dot": lambda x: x @ x[0],
        "squares": lambda x: jnp.sum(x * x, 1),
    }[kind]

    def run(rate):
        def turn(state):
            i, y, x, _ = state
            change = rate(y)
            return i + 1, y + 0.01 * change, x * (1 + 1e-3 * change[0]), reduced(x)

        start = jnp.zeros((), jnp.int64), ARGUMENTS[0], jnp.ones((n, 40)), jnp.zeros(n)
        return jax.lax.while_loop(lambda state: state[0] < 4, turn, start)

    expected = jax.jit(lambda: run(field))()
    with machine_code.native_code():
        found = jax.jit(fuse_loops(lambda: run(FIELD)))()
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_loops_without_calls_are_left_alone():
    def text(wrap):
        return jax.jit(wrap(wandering(field))).lower(*ARGUMENTS).as_text()

    with machine_code.native_code():
        assert "xla_cpu_small_call" not in text(fuse_loops)
    assert text(fuse_loops) == text(lambda function: function)  # and so is everything where it is not wanted


def test_arguments_that_nothing_reads_do_not_end_the_process():
    """XLA aborts where a small function has some; here each is returned in part."""
    code = """
import spherejax, jax, jax.numpy as jnp
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler import primitive
from spherejax.compiler.native.loop_fusion import fuse_loops
from spherejax.compiler.program import scalarize
primitive.SMALLEST_CALLED = 0
double = scalarize(lambda y: 2.0 * y, jnp.ones(3))
def body(state):
    i, y, z, flag, n = state
    y = double(y) * jnp.where(False, 1.0 * z[0, 0] * n + flag, 1.0) - jnp.where(False, n, 1)
    return i + 1, y, z, flag, n
def run(*start):
    return jax.lax.while_loop(lambda state: state[0] < 5, body, (0, *start))[1]
with machine_code.native_code():
    print(jax.jit(fuse_loops(run))(2 * jnp.ones(3), jnp.zeros((2, 2)), jnp.array(True), jnp.array(3)))
"""
    environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["[33.", "33.", "33.]"]


class Given(NamedTuple):
    theta: jax.Array
    ahead: tuple


N_RUNS = [1, 2, 3, 8, 21]
"""One run, runs that fill vectors, and others."""


def of_runs(n: int, *values):
    """Numbers of several runs, each other than the first's, with a last axis of runs."""
    return jax.tree.map(
        lambda x: x[..., None] * (1 + jnp.arange(n) / 16) if jnp.issubdtype(x.dtype, jnp.floating) else x[..., None],
        values,
    )


@pytest.mark.parametrize(
    ("method", "size", "n_runs"),
    [
        *((method, size, n) for method, size in ((diffrax.Dopri8(), 7), (diffrax.Heun(), 21)) for n in N_RUNS),
        (diffrax.Dopri8(), 1, 8),
        (diffrax.Tsit5(), 8, 3),
        (diffrax.Heun(), 600, 1),
        (diffrax.Heun(), 600, 21),
    ],
)
def test_stages_in_one_call_are_those_of_the_loop(method, size, n_runs):
    """Of states whose entries fill vectors, or do not; in bent time; and not all of them."""

    def rate(theta, t, y):
        return jnp.roll(y, 1) * theta[0] - jnp.sin(theta[1] * t) * y * y

    theta, y = jnp.array([0.7, 2.0]), 0.1 + jnp.arange(float(size)) / size
    program = scalarize(rate, theta, jnp.zeros(()), y)
    steps = ExplicitStages(
        method.tableau, lambda t, y, given: program.inside(given.ahead, given.theta, t, y), True, program
    )
    thetas, *lanes = of_runs(n_runs, theta, jnp.array(0.2), jnp.array(0.3), y)
    given = Given(thetas, in_lanes(program.ahead)(thetas))

    def increments(bend, n):
        bends = bend * (1 - jnp.arange(n_runs) / 64)
        t, t_next, y = lanes
        return steps.step(t, t_next, y, given, (), jnp.zeros(n_runs, bool), bends, n).dense_info["k"]

    for bend, n in ((0.0, None), (-0.6, None), (0.9, jnp.array(2)), (0.3, jnp.array(0))):
        expected = increments(bend, n)
        with machine_code.native_code():
            text = jax.jit(increments).lower(bend, n).as_text()
            found = jax.jit(increments)(bend, n)
        assert text.count("stablehlo.custom_call @spherejax_") == 1
        assert "stablehlo.while" not in text
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14 * np.max(np.abs(expected)))


@pytest.mark.parametrize("n_runs", [1, 3])
def test_what_has_no_weight_does_not_count(n_runs):
    """Dopri8's last stage is for what is inside a step: what it meets there says nothing of the end."""

    def rate(theta, t, y):
        return jnp.where(y > theta[0], 1 / (y - y), jnp.ones(1))

    theta = jnp.array([0.5])
    program = scalarize(rate, theta, jnp.zeros(()), jnp.zeros(1))
    tableau = diffrax.Dopri8().tableau
    steps = ExplicitStages(tableau, lambda t, y, given: program.inside((), given.theta, t, y), True, program)
    used = steps.n_used
    A = np.array(steps.tableau.A)
    A[used:, 0] += 10.0  # the stages behind are in what is infinite
    steps.tableau = Tableau.explicit(A, steps.tableau.c, steps.tableau.sums)
    given = Given(jnp.tile(theta[:, None], n_runs), ())
    lane = jnp.zeros(n_runs), jnp.full(n_runs, 0.1), jnp.zeros((1, n_runs)), given, (), jnp.zeros(n_runs, bool)
    with machine_code.native_code():
        trial = jax.jit(steps.step)(*lane, jnp.zeros(n_runs))
    increments = trial.dense_info["k"]
    assert np.all(np.isfinite(increments[:used]))
    assert not np.any(np.isfinite(increments[used:]))
    np.testing.assert_allclose(trial.y, 0.1, rtol=1e-12)
    np.testing.assert_allclose(trial.error, 0.0, atol=1e-12)


class Rows(NamedTuple):
    value: Given
    slopes: Given

    @property
    def theta(self):
        return self.value.theta

    @property
    def ahead(self):
        return self.value.ahead


@pytest.mark.parametrize(
    ("n_rows", "size", "n_runs"),
    [
        *((2, 21, n) for n in N_RUNS),
        (1, 7, 1),
        (1, 7, 3),
        (3, 1, 8),
        (4, 7, 2),
        (5, 21, 1),
        (5, 21, 8),
        (9, 7, 1),
        (9, 7, 21),
    ],
)
def test_stages_with_rows_in_one_call_are_those_of_the_loop(n_rows, size, n_runs):
    """Of as many rows as fill vectors, and others; with numbers and truths that are evaluated ahead of the loop."""

    def rate(theta, t, y):
        stiff = jnp.where(theta[0] > 0.5, theta[1] ** 2, 1.0)
        return jnp.roll(y, 1) * jnp.exp(theta[0]) - jnp.where(y > 0.5, jnp.sin(theta[1] * t) * y * y, stiff * y)

    theta, y = jnp.array([0.7, 2.0]), 0.1 + jnp.arange(float(size)) / size
    program = scalarize(rate, theta, jnp.zeros(()), y)
    directions = jnp.cos(jnp.arange(2.0 * n_rows)).reshape(n_rows, 2)
    rows = jnp.concatenate([y[None], jnp.sin(jnp.arange(1.0 * n_rows * size)).reshape(n_rows, size)])
    inside = Inside(program)
    steps = ExplicitStages(
        diffrax.Dopri8().tableau, lambda t, rows, given: rows_rate(inside, given, t, rows), True, program
    )
    thetas, *lanes = of_runs(n_runs, theta, jnp.array(0.2), jnp.array(0.3), rows)

    def numbers_of(theta):
        return Rows(*linearized(lambda theta: Given(theta, program.ahead(theta)), theta, directions))

    given = in_lanes(numbers_of)(thetas)

    def increments(bend, n):
        bends = bend * (1 - jnp.arange(n_runs) / 64)
        t, t_next, rows = lanes
        return steps.step(t, t_next, rows, given, (), jnp.zeros(n_runs, bool), bends, n).dense_info["k"]

    for bend, n in ((0.0, None), (-0.6, None), (0.9, jnp.array(2)), (0.3, jnp.array(0))):
        expected = increments(bend, n)
        with machine_code.native_code():
            text = jax.jit(increments).lower(bend, n).as_text()
            found = jax.jit(increments)(bend, n)
        assert text.count("stablehlo.custom_call @spherejax_") == 1
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * np.max(np.abs(expected)))


@pytest.mark.parametrize(("n_rows", "n_runs"), [(1, 1), (3, 1), (2, 3), (3, 8)])
def test_rows_by_some_numbers_are_those_by_all(n_rows, n_runs):
    """Of numbers that lie apart; what they change ahead of the loop moves, and nothing else."""

    def rate(theta, t, y):
        return (
            jnp.roll(y, 1) * jnp.exp(theta[0]) * theta[3]
            - jnp.sin(theta[1] * t) * y * y * jnp.cosh(theta[4])
            - theta[2]
        )

    theta, y = jnp.array([0.7, 2.0, 0.1, 0.5, 0.3]), 0.1 + jnp.arange(7.0) / 7
    program = scalarize(rate, theta, jnp.zeros(()), y)
    moving = (0, 2, 3)
    directions = (
        jnp.zeros((n_rows, 5)).at[:, jnp.array(moving)].set(jnp.cos(jnp.arange(3.0 * n_rows)).reshape(n_rows, 3))
    )
    rows = jnp.concatenate([y[None], jnp.sin(jnp.arange(7.0 * n_rows)).reshape(n_rows, 7)])
    thetas, *lanes = of_runs(n_runs, theta, jnp.array(0.2), jnp.array(0.3), rows)

    def numbers_of(theta):
        return Rows(*linearized(lambda theta: Given(theta, program.ahead(theta)), theta, directions))

    given, found = in_lanes(numbers_of)(thetas), []
    for some in (None, moving):
        steps = ExplicitStages(diffrax.Dopri8().tableau, lambda *_: None, True, program, some)

        def increments(t, t_next, rows, steps=steps):
            return steps.step(t, t_next, rows, given, (), jnp.zeros(n_runs, bool), jnp.zeros(n_runs)).dense_info["k"]

        with machine_code.native_code():
            found.append(jax.jit(increments)(*lanes))
    assert np.max(np.abs(found[0][:, 1:])) > 0.1
    np.testing.assert_allclose(found[1], found[0], rtol=1e-13, atol=1e-15)


class Inside(NamedTuple):
    program: Any

    def inside(self, theta, ahead, t, y):
        return self.program.inside(ahead, theta, t, y)


# Runs -----------------------------------------------------------------------------------------------------------------

TS = jnp.linspace(0.0, 0.02, 5)


def film(viscosity):
    return sj.simulate(sj.gallery.four_bar(sj.Lubricated(cases.C, viscosity)), TS, rtol=1e-9)


@pytest.mark.parametrize("drift", [sj.solvers.Baumgarte(), sj.solvers.PostStabilization()])
@pytest.mark.parametrize("name", ["ideal", "friction", "bushing"])
def test_an_explicit_run_is_what_xla_makes_of_it(name, drift, monkeypatch):
    """Through onsets, with every sample, and with as many steps but for some that rounding decides."""

    def made():
        scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name], drift=drift)
        return sj.simulate(scene, jnp.linspace(0.0, 0.05, 17), rtol=1e-9)

    with monkeypatch.context() as patched:
        patched.setattr(machine_code, "is_available", lambda: False)
        expected = made()
        jax.clear_caches()
    for function in (integrated, before_first_window, advance_window):
        function.clear()
    run = made()
    assert int(run.stats.n_steps) == pytest.approx(int(expected.stats.n_steps), rel=0.1)
    np.testing.assert_array_equal(run.stats.n_onsets, expected.stats.n_onsets)
    np.testing.assert_allclose(run.ys, expected.ys, rtol=1e-8, atol=1e-8)
    assert np.max(np.abs(run.ys - expected.ys)) > 0  # they are two programs


@pytest.mark.parametrize(("name", "n_rows"), [("ideal", 1), ("friction", 1), ("friction", 3), ("bushing", 3)])
def test_derivatives_of_an_explicit_run_are_what_xla_makes_of_them(name, n_rows, monkeypatch):
    """Through onsets."""

    def height(moved):
        scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])
        bodies = {
            body: eqx.tree_at(lambda b: (b.mass, b.position), each, (each.mass * moved[0], each.position + shift))
            for (body, each), shift in zip(scene.bodies.items(), shifts(moved), strict=True)
        }
        return sj.simulate(eqx.tree_at(lambda s: s.bodies, scene, bodies), jnp.linspace(0, 0.02, 9), rtol=1e-9).ys

    def shifts(moved):
        mixed = jnp.cos(jnp.outer(jnp.arange(9.0), jnp.arange(1.0, 1 + n_rows))) @ (moved - 1)
        return 1e-6 * mixed.reshape(3, 3)

    def made():
        return jax.jit(jax.jacfwd(height))(jnp.ones(n_rows))

    with monkeypatch.context() as patched:
        patched.setattr(machine_code, "is_available", lambda: False)
        expected = made()
        jax.clear_caches()
    for function in (integrated, before_first_window, advance_window, _with_slopes):
        function.clear()
    with machine_code.record_ffi_targets() as codes:
        found = made()
    assert codes()
    for of_found, of_expected in zip(np.moveaxis(found, -1, 0), np.moveaxis(expected, -1, 0), strict=True):
        largest = np.max(np.abs(of_expected))
        assert largest > 0
        np.testing.assert_allclose(of_found, of_expected, rtol=1e-6, atol=1e-6 * largest)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:derivatives by Rodas5P are not sure")  # the exponent of the contact is among them
@pytest.mark.parametrize("name", ["bushing", "lubricated"])
def test_a_run_is_differentiated_by_all_of_its_numbers(name):
    """Some ninety rows: more than fit in the arrays that kernels take."""
    numbers, scene = ravel_pytree(jax.tree.map(jnp.asarray, sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])))

    def height(numbers):
        return sj.simulate(scene(numbers), TS, rtol=1e-9).position("rocker")[-1, 2]

    slopes = jax.jit(jax.jacfwd(height))(numbers)
    assert numbers.size > 80
    assert np.all(np.isfinite(slopes))
    at = int(jnp.argmax(jnp.abs(slopes * numbers)))
    step = 1e-5 * jnp.abs(numbers[at]) * jnp.eye(numbers.size)[at]
    difference = (height(numbers + step) - height(numbers - step)) / (2 * step[at])
    assert slopes[at] == pytest.approx(float(difference), rel=1e-5)


def test_what_is_observed_is_what_xla_makes_of_it(monkeypatch):
    """All quantities of all samples, also mapped and differentiated."""
    run = sj.simulate(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["friction"]), TS, rtol=1e-6)
    structure, theta = flatten_system(run.system)
    args = structure, run.scalar

    def made():
        observed.clear()
        theta_now = jnp.asarray(theta)
        several = jnp.stack([run.ys, 1.001 * run.ys])
        yield observed(*args, theta_now, run.ts, run.ys)
        yield jax.jit(jax.vmap(lambda ys: observed(*args, theta_now, run.ts, ys)))(several)
        yield jax.jit(jax.jacfwd(lambda s: observed(*args, theta_now, run.ts, s * run.ys)))(1.0)
        yield jax.jit(jax.grad(lambda s: jnp.sum(observed(*args, theta_now, run.ts, s * run.ys).kinetic_energy)))(1.0)

    with machine_code.record_ffi_targets() as codes:
        found = [*made()]
    assert codes()
    with monkeypatch.context() as patched:
        patched.setattr(machine_code, "is_available", lambda: False)
        jax.clear_caches()
        expected = [*made()]
    observed.clear()
    for each, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(each, other, rtol=1e-7, atol=1e-12 + 1e-7 * np.max(np.abs(other), initial=0))


@pytest.mark.parametrize("name", ["ideal", "friction", "lubricated"])
def test_a_scene_whose_numbers_are_known_to_the_compiler(name):
    """XLA writes what it knows into functions, and aborts where that leaves an argument unread."""
    scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])
    found = jax.jit(lambda rtol: sj.simulate(scene, TS, rtol=rtol).ys)(1e-8)
    np.testing.assert_allclose(found, sj.simulate(scene, TS, rtol=1e-8).ys, rtol=1e-9, atol=1e-7)


def test_a_stiff_run_and_its_derivatives_are_what_xla_makes_of_them(monkeypatch):
    """To the tolerance, and with as many steps."""

    def both():
        run, slope = film(0.4), jax.jit(jax.jacfwd(lambda v: film(v).position("rocker")[-1]))(0.4)
        return run, slope

    run, slope = both()
    monkeypatch.setattr(machine_code, "is_available", lambda: False)
    jax.clear_caches()
    for function in (integrated, before_first_window, advance_window, _with_slopes):
        function.clear()
    other, other_slope = both()
    assert int(run.stats.n_steps) == pytest.approx(int(other.stats.n_steps), abs=2)
    np.testing.assert_allclose(run.ys, other.ys, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slope, other_slope, rtol=1e-4, atol=1e-10)


RUN = """
import sys, time, jax, jax.numpy as jnp
import spherejax as sj
from spherejax.compiler.native import compile as machine_code
scene = sj.gallery.four_bar(sj.Bushing(1e6, 1e-4))
begin = time.process_time()
run = sj.simulate(scene, jnp.linspace(0.0, 0.005, 3))
seconds = time.process_time() - begin
print(seconds, len(machine_code._loaded), float(run.ys[-1, 0]).hex())
"""


def said_by(**environment):
    done = subprocess.run(
        [sys.executable, "-c", RUN], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    seconds, n_loaded, number = done.stdout.split()
    return float(seconds), int(n_loaded), float.fromhex(number)


def test_another_process_finds_what_was_kept_and_does_without(tmp_path):
    """Kept programs call machine code that is kept with them; without it the same run is compiled by XLA."""
    cache = {"SPHEREJAX_CACHE": str(tmp_path)}
    first, n_first, number = said_by(**cache)
    again, n_again, same = said_by(**cache)
    assert n_first == n_again > 0
    assert same == number
    assert again < 0.5 * first
    _, n_none, other = said_by(**cache, SPHEREJAX_MACHINE_CODE="0")
    assert n_none == 0
    assert other == pytest.approx(number, rel=1e-9)


def test_long_vectors_are_for_groups_of_runs_alone():
    """Few of them among numbers that stand alone slow a processor down; a line with lanes may have them."""
    llvm = pytest.importorskip("llvmlite.binding")
    text = """\
define void @doubled(ptr %a) nounwind {
  %x = load <8 x double>, ptr %a, align 8
  %y = fadd <8 x double> %x, %x
  store <8 x double> %y, ptr %a, align 8
  ret void
}
"""

    def assembly(is_wide, is_optimised):
        machine = machine_code._target_machine(is_wide, is_optimised)
        return machine.emit_assembly(llvm.parse_assembly(machine_code._with_widths(text, is_wide)))

    has_long_ones = dict(llvm.get_host_cpu_features()).get("avx512f", False)
    assert ("zmm" in assembly(True, True)) == has_long_ones
    assert all("zmm" not in assembly(False, is_optimised) for is_optimised in (True, False))


def test_damaged_machine_code_is_made_anew(tmp_path):
    cache = {"SPHEREJAX_CACHE": str(tmp_path)}
    _, _, number = said_by(**cache)
    for file in (tmp_path / "kept").glob("*"):
        file.write_bytes(file.read_bytes()[:-100])
    _, n_loaded, again = said_by(**cache)
    assert n_loaded > 0
    assert again == number


@pytest.mark.parametrize(
    ("n", "is_written"),
    [(1000, True), (1205, True), (4093, True), (5000, True), (40_000, True), (300_000, False)],
)
def test_arrays_of_many_entries_in_a_loop(small_ones_too, n, is_written):
    """As loops of their own, from 40,000 on with room beside the stack; where they are larger the loop is left as it
    is."""

    def run(rate):
        def turn(state):
            i, y, x, is_small = state
            change = rate(y)
            turned = jnp.concatenate([x[7:], x[:7]]) + jnp.broadcast_to(change[1], n)
            x = jnp.where(is_small, x * (1 + 1e-3 * change[0]), 0.5 * turned)
            return i + 1, y + 0.01 * change, x, jnp.abs(x) < 1

        start = jnp.zeros((), jnp.int64), ARGUMENTS[0], jnp.linspace(-2.0, 2.0, n), jnp.arange(n) % 3 > 0
        return jax.lax.while_loop(lambda state: state[0] < 5, turn, start)

    expected = jax.jit(lambda: run(field))()
    with machine_code.native_code():
        whole = whole_loops(lambda: run(FIELD))
        assert ("loop_in_machine_code" in str(jax.make_jaxpr(whole)())) is is_written
        found = jax.jit(whole)()
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)


def rows_by_loops(rate, of_inner):
    """Rows of a long array, written by a loop in a loop that reads what the turn before it has written."""

    def turn(state):
        i, y, rows = state

        def with_row(state):
            j, y, rows = state
            y = y + 0.01 * rate(y)
            return j + 1, y, jax.lax.dynamic_update_index_in_dim(rows, y, 7 * i + j, 0)

        def inner():
            return jax.lax.while_loop(lambda state: state[0] < 5, with_row, (jnp.zeros((), jnp.int64), y, rows))

        _, last, rows = of_inner(inner)()
        return i + 1, last + 0.1 * rows[7 * jnp.maximum(i - 1, 0)], rows

    start = jnp.zeros((), jnp.int64), ARGUMENTS[0], jnp.zeros((2000, ARGUMENTS[0].size))
    return jax.lax.while_loop(lambda state: state[0] < 4, turn, start)


def test_a_loop_around_a_loop_that_is_machine_code_already(small_ones_too):
    """It calls the other one, which changes a large array in place."""
    expected = jax.jit(lambda: rows_by_loops(field, lambda inner: inner))()
    with machine_code.native_code():
        whole = whole_loops(lambda: rows_by_loops(FIELD, whole_loops))
        text = str(jax.make_jaxpr(whole)())
        assert "loop_in_machine_code" in text
        assert "while" not in text
        results = jax.jit(whole)()
        again = jax.jit(lambda: jax.lax.map(lambda _: whole(), jnp.zeros(3)))()
    for one, other, third in zip(results, expected, again, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-15)
        np.testing.assert_array_equal(third[2], one)


@pytest.mark.parametrize(("n_more", "is_left"), [(1, False), (2, True)])
def test_loops_around_loops_are_left_to_xla_beyond_three(small_ones_too, n_more, is_left):
    def within(rate, of_inner, n):
        if n == 0:
            return lambda: rows_by_loops(rate, of_inner)[1]

        def turn(state):
            i, y = state
            return i + 1, y + of_inner(within(rate, of_inner, n - 1))() * y

        return lambda: jax.lax.while_loop(lambda s: s[0] < 3, turn, (jnp.zeros((), jnp.int64), ARGUMENTS[0]))[1]

    expected = jax.jit(within(field, lambda inner: inner, n_more))()
    with machine_code.native_code():
        whole = whole_loops(within(FIELD, whole_loops, n_more))
        assert ("while" in str(jax.make_jaxpr(whole)())) is is_left
        results = jax.jit(whole)()
    np.testing.assert_allclose(results, expected, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("counts", [[2], [3, 1, 2], [0, 0]])
def test_a_loop_whose_lanes_end_one_by_one(small_ones_too, counts):
    def run(y, n):
        return jax.lax.while_loop(lambda s: s[0] < n, lambda s: (s[0] + 1, s[1] + 0.1 * FIELD(s[1])), (0, y))[1]

    given = jnp.linspace(0.1, 1.0, 3 * len(counts)).reshape(-1, 3), jnp.array(counts)
    expected = [run(y, n) for y, n in zip(*given, strict=True)]
    with machine_code.native_code():
        alone = jax.jit(fuse_loops(jax.vmap(run)))(*given)
        within = jax.jit(fuse_loops(lambda *x: jax.lax.fori_loop(0, 1, lambda _, y: jax.vmap(run)(y, x[1]), x[0])))
        np.testing.assert_allclose(alone, expected, rtol=1e-13)
        np.testing.assert_allclose(within(*given), expected, rtol=1e-13)


def test_an_unknown_operation_is_left_to_xla(small_ones_too, monkeypatch):
    x = jnp.array([0.3, 1.7])
    made = scalarize(lambda x: jnp.exp(x) + x**2, x)
    with machine_code.native_code():
        assert n_calls(made, x) == 1
    other = scalarize(lambda x: jnp.exp(x) + x**2, x)
    monkeypatch.setitem(OPERATIONS, "exp", dataclasses.replace(OPERATIONS["exp"], llvm=None))
    with machine_code.native_code():
        assert n_calls(other, x) == 0
        np.testing.assert_allclose(jax.jit(other)(x), np.exp(x) + x**2, rtol=1e-14)
