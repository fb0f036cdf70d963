"""Ros34PW2: coefficients, orders with any matrix, and the joint forces alone as a mechanism's implicit part."""

from functools import lru_cache

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.problem import Parameters
from spherejax.motion.solvers.implicit import inexact_systems_of, systems_of, with_structure
from spherejax.motion.solvers.low_rank import inexact_product, solve_inexact_stage
from spherejax.motion.solvers.rosenbrock_tableaus import ROS34PW2

Y0 = np.array([1.0, 0.5])


def smooth(t, y, args):
    """Nonlinear and explicitly dependent on time."""
    return jnp.array([y[1] * jnp.cos(t), -y[0] * y[1] + jnp.sin(2 * t)])


def nothing(t, y, args):
    """No Jacobian at all: the method is then explicit."""
    return jnp.zeros((2, 2)), jnp.zeros(2)


def anything(t, y, args):
    """A matrix and a time derivative that have nothing to do with the field."""
    return jnp.array([[0.7, -1.3], [2.1, -0.4]]), jnp.array([0.3, -0.8])


EXACT_OR_NOT = pytest.mark.parametrize(
    "solver",
    [sj.solvers.Ros34PW2(), sj.solvers.Ros34PW2(jacobian=nothing), sj.solvers.Ros34PW2(jacobian=anything)],
    ids=["exact", "zero", "arbitrary"],
)


@eqx.filter_jit
def integrate(field, solver, t1, y0, args=None, *, n_steps=None, rtol=1e-8, atol=None):
    fixed = n_steps is not None
    controller = (
        diffrax.ConstantStepSize() if fixed else diffrax.PIDController(rtol=rtol, atol=rtol if atol is None else atol)
    )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        0.0,
        t1,
        t1 / n_steps if fixed else 1e-6,
        y0,
        args,
        stepsize_controller=controller,
        max_steps=100_000,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys[-1]


def slopes(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


# Coefficients


def classical():
    """Weights, embedded weights, alpha and Gamma of Hairer & Wanner, section IV.7."""
    tableau = ROS34PW2
    Gamma = np.linalg.inv(np.eye(4) / tableau.gamma - tableau.C)
    return tableau.b @ Gamma, (tableau.b - tableau.e) @ Gamma, tableau.A @ Gamma, Gamma


def conditions(b, alpha, Gamma):
    """What the order conditions of a W-method set to 1, 1/2, 0, and to 1/3, 1/6, 0, 0, 0."""
    c, d = alpha.sum(1), Gamma.sum(1)
    return [b.sum(), b @ c, b @ d], [b @ c**2, b @ alpha @ c, b @ alpha @ d, b @ Gamma @ c, b @ Gamma @ d]


def test_order_conditions_with_any_matrix():
    b, embedded, alpha, Gamma = classical()
    two, three = conditions(b, alpha, Gamma)
    np.testing.assert_allclose(two, [1, 1 / 2, 0], atol=1e-14)
    np.testing.assert_allclose(three, [1 / 3, 1 / 6, 0, 0, 0], atol=1e-14)
    two, three = conditions(embedded, alpha, Gamma)
    np.testing.assert_allclose(two, [1, 1 / 2, 0], atol=1e-14)
    assert abs(three[0] - 1 / 3) > 0.05
    np.testing.assert_allclose(np.diag(Gamma), ROS34PW2.gamma, rtol=1e-14)
    np.testing.assert_allclose(ROS34PW2.c, alpha.sum(1), atol=1e-14)
    np.testing.assert_allclose(ROS34PW2.d, Gamma.sum(1), atol=1e-14)


def test_stiffly_accurate_and_l_stable():
    b, _, alpha, Gamma = classical()
    np.testing.assert_allclose((alpha + Gamma)[-1], b, atol=1e-14)
    ones = np.ones(4)
    np.testing.assert_allclose(1 - b @ np.linalg.solve(alpha + Gamma, ones), 0.0, atol=1e-13)
    for z in 1j * np.logspace(-2, 6, 200):
        assert abs(1 + z * b @ np.linalg.solve(np.eye(4) - z * (alpha + Gamma), ones)) < 1 + 1e-9


def test_dense_output_fulfills_the_conditions_of_order_two():
    b, _, alpha, Gamma = classical()
    first, second = ROS34PW2.H @ Gamma
    for x in (0.2, 0.5, 0.9):
        weights = x * (b + (1 - x) * (first + x * second))
        two, three = conditions(weights, alpha, Gamma)
        np.testing.assert_allclose(two, [x, x**2 / 2, 0], atol=1e-13)
        np.testing.assert_allclose(three[0], x**3 / 3, atol=1e-13)


# Orders observed


@EXACT_OR_NOT
def test_order_of_steps(solver):
    wanted = integrate(smooth, diffrax.Dopri8(), 2.0, Y0, rtol=1e-13)
    errors = [np.abs(integrate(smooth, solver, 2.0, Y0, n_steps=n) - wanted).max() for n in (40, 80, 160)]
    np.testing.assert_allclose(slopes(errors), 3, atol=0.25)


@EXACT_OR_NOT
def test_order_of_error_estimate_and_of_dense_output(solver):
    """The estimate is that of a method of order 2; within a step the dense output errs by O(h^3), exact J: O(h^4)."""
    term = diffrax.ODETerm(smooth)

    @jax.jit
    def step(h):
        _, error, dense, _, _ = solver.step(term, 0.0, h, Y0, None, None, False)
        return error, solver.interpolation_cls(t0=jnp.array(0.0), t1=h, **dense).evaluate(0.4 * h)

    estimates, errors = [], []
    for h in (0.016, 0.008, 0.004):
        estimate, between = step(h)
        estimates.append(np.linalg.norm(estimate))
        errors.append(np.linalg.norm(between - integrate(smooth, diffrax.Dopri8(), 0.4 * h, Y0, rtol=1e-14)))
    np.testing.assert_allclose(slopes(estimates), 3, atol=0.25)
    np.testing.assert_allclose(slopes(errors), 4 if solver.jacobian is None else 3, atol=0.25)


def test_prothero_robinson_does_not_blow_up():
    """y' = lambda (y - g) + g', lambda = -1e6; what remains of the error is of size h^2 / |lambda| and less."""

    def field(t, y, args):
        return -1e6 * (y - jnp.sin(t)) + jnp.cos(t)

    steps = np.array([8, 16, 32])
    errors = [
        abs(integrate(field, sj.solvers.Ros34PW2(), 2.0, jnp.zeros(1), n_steps=n)[0] - np.sin(2.0)) for n in steps
    ]
    assert (np.array(errors) < (2.0 / steps) ** 2 / 1e6).all()
    assert slopes(errors).min() > 1.8


def test_van_der_pol():
    """Published end state at t = 2 for epsilon = 1e-6: F. Mazzia, C. Magherini, Test set for IVP solvers, 2008."""

    def field(t, y, epsilon):
        return jnp.array([y[1], ((1 - y[0] ** 2) * y[1] - y[0]) / epsilon])

    wanted = np.array([1.706167732170483, -0.8928097010247975])
    errors = [
        np.abs(integrate(field, sj.solvers.Ros34PW2(), 2.0, np.array([2.0, 0.0]), 1e-6, rtol=tol) / wanted - 1).max()
        for tol in (1e-4, 1e-7)
    ]
    assert errors[0] < 1e-2
    assert errors[1] < 1e-4


# The stage of a mechanism

BUSHING = sj.Bushing(stiffness=1e6, damping=1e-2)
TURNING = sj.Bushing(
    law=sj.laws.MatrixElastomer(
        stiffness=jnp.diag(jnp.array([1e6, 2e6, 3e6])),
        damping=1e3 * jnp.eye(3),
        rotational_stiffness=jnp.diag(jnp.array([50.0, 60.0, 70.0])),
        rotational_damping=0.1 * jnp.eye(3),
    )
)


def two_joints():
    """Force joints at both ends of the coupler."""
    return eqx.tree_at(lambda s: s.joints["crank_coupler"].model, sj.gallery.four_bar(TURNING), BUSHING)


SYSTEMS = {
    "ideal": (sj.gallery.four_bar, False, 1e-4),
    "dry": (lambda: sj.gallery.four_bar(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1))), False, 1.1e-4),
    "film": (lambda: sj.gallery.four_bar(sj.Lubricated(clearance=1e-4)), False, 9e-5),
    "two joints": (two_joints, True, 1e-5),
}
"""Scene, whether the work is tracked, and how far crank and rocker are displaced [m]."""


@lru_cache
def parts(name):
    """Structure, numbers and a moving state with strained joints."""
    build, track_work, shift = SYSTEMS[name]
    system = compile_scene(build(), track_work=track_work).system
    structure, theta = flatten_system(system)
    rng = np.random.default_rng(1)
    layout = system.layout
    motion = [[*body.position, *body.quaternion] for body in system.bodies.values()]
    y = np.concatenate([np.ravel(motion), 0.01 * rng.normal(size=layout.size - layout.n_position)])
    for name in ("crank", "rocker"):
        start = 7 * list(system.bodies).index(name)
        y[start : start + 3] += shift * np.array([0.6, 0.0, 0.8])
    y[layout.memory_start : layout.work_start] = 0.1  # touching, since an onset at 0.1 m/s
    return structure, theta, y


def columns(multiply, n):
    return np.stack([multiply(unit) for unit in np.eye(n)], 1)


@pytest.mark.parametrize("name", list(SYSTEMS))
def test_stage_solves_the_system_with_the_approximate_matrix(name):
    structure, theta, y = parts(name)
    n, gamma_h = len(y), 1e-4
    stage = program_for(solve_inexact_stage, structure, True, (n, 1, n), 4)
    product = program_for(inexact_product, structure, True, (n, n))
    matrix = columns(lambda unit: product.compute(theta, 0.0, (y, unit)), n)
    rhs = np.random.default_rng(0).normal(size=n)
    k = stage.compute(theta, 0.0, (y, np.array([gamma_h]), rhs))
    dense = np.linalg.solve(np.eye(n) - gamma_h * matrix, rhs)
    np.testing.assert_allclose(k, dense, rtol=1e-7, atol=1e-9)
    assert (np.abs(matrix).max() > 1e3) == (name != "ideal")


def exact_matrix(name, y, size=1e-8):
    structure, theta, _ = parts(name)
    rate = program_for(state_rate, structure)

    def multiply(unit):
        return (rate.compute(theta, 0.0, y + size * unit) - rate.compute(theta, 0.0, y - size * unit)) / (2 * size)

    return columns(multiply, len(y))


@pytest.mark.parametrize("name", ["dry", "film", "two joints"])
def test_what_is_left_out_is_not_stiff(name):
    """The exact matrix has eigenvalues of 3e3 to 1e6 1/s here; what is left out moves none of them by 2 percent."""
    structure, theta, y = parts(name)
    product = program_for(inexact_product, structure, True, (len(y), len(y)))
    inexact = np.linalg.eigvals(columns(lambda unit: product.compute(theta, 0.0, (y, unit)), len(y)))
    exact = np.linalg.eigvals(exact_matrix(name, y))
    fast = exact[np.abs(exact) > 3e3]
    assert len(fast) >= 2
    for value in fast:
        assert np.abs(inexact - value).min() < 0.02 * abs(value)


def test_a_system_with_bristles_keeps_the_exact_matrix():
    model = sj.Dry(clearance=1e-4, friction=sj.LuGre())
    structure, _ = flatten_system(compile_scene(sj.gallery.four_bar(model)).system)
    assert inexact_systems_of(structure) is systems_of(structure)


# Steps of a mechanism


@pytest.fixture(scope="module")
def film_step():
    """One compiled step of the lubricated four-bar as a function of (theta, y, h), and a point."""
    structure, theta, y = parts("film")
    rate = program_for(state_rate, structure)
    solver = with_structure(sj.solvers.Ros34PW2(), structure)
    term = diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y))

    def step(theta, y, h):
        args = Parameters(theta, rate.ahead(theta))
        y1, error, _, _, _ = solver.step(term, 0.0, h, y, args, None, False)
        return jnp.stack([y1, error])

    return jax.jit(step), jnp.asarray(theta), jnp.asarray(y)


@pytest.mark.slow
def test_derivative_of_a_step_is_that_of_the_discrete_step(film_step):
    """Along theta, state and step size; the approximate matrix is differentiated as well."""
    step, theta, y = film_step
    rng = np.random.default_rng(3)
    point = (theta, y, jnp.asarray(1e-4))
    along = (theta * rng.normal(size=theta.shape), 1e-2 * rng.normal(size=y.shape) * np.abs(y), jnp.asarray(1e-4))
    tangent = jax.jit(lambda p, d: jax.jvp(step, p, d))(point, along)[1]
    errors = []
    for size in (1e-6, 1e-7):
        forward, backward = (step(*(p + s * size * d for p, d in zip(point, along, strict=True))) for s in (1, -1))
        difference = (forward - backward) / (2 * size)
        errors.append(np.abs(tangent - difference).max(1) / np.abs(difference).max(1))
    assert (errors[1] < 1e-3).all()
    assert (errors[1] < errors[0] / 50).all()  # what is left is the differences' own error


@pytest.mark.slow
def test_vmap_of_steps_equals_loop(film_step):
    step, theta, y = film_step
    sizes = jnp.array([1e-6, 1e-5, 1e-4])
    together = jax.vmap(step, (None, None, 0))(theta, y, sizes)
    for h, lane in zip(sizes, together, strict=True):
        np.testing.assert_allclose(lane, step(theta, y, h), rtol=1e-7, atol=1e-9)


# Motions


@pytest.mark.parametrize(
    "name", ["bushing", *(pytest.param(name, marks=pytest.mark.slow) for name in ("film", "friction"))]
)
def test_agrees_with_a_method_of_high_order(name):
    model, end = {
        "film": (sj.Lubricated(clearance=1e-4), 0.01),
        "bushing": (sj.Bushing(stiffness=1e6, damping=1e-4), 0.06),
        "friction": (sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1)), 0.06),
    }[name]
    scene, ts = sj.gallery.four_bar(model), jnp.array([0.0, 0.3, 1.0]) * end
    wanted = sj.simulate(scene, ts, rtol=1e-9, atol=1e-12, solver=diffrax.Dopri8()).position("rocker")
    errors = []
    for tol in (1e-4, 1e-6):
        run = sj.simulate(scene, ts, rtol=tol, atol=1e-3 * tol, solver=sj.solvers.Ros34PW2())
        assert int(run.status) == sj.Status.SUCCEEDED
        assert int(run.stats.n_evaluations) == 4 * int(run.stats.n_steps)
        errors.append(np.abs(run.position("rocker") - wanted).max())
    assert errors[0] < 1e-5
    assert errors[1] < 1e-7


@pytest.mark.slow
def test_sensitivity_of_a_motion():
    """Forward sensitivity by the stiffness of a stiff bushing against differences, at two tolerances."""

    def height(stiffness, tol):
        scene = sj.gallery.four_bar(sj.Bushing(stiffness=stiffness, damping=1e-2))
        ts = jnp.array([0.0, 0.05])
        run = sj.simulate(scene, ts, rtol=tol, atol=1e-3 * tol, solver=sj.solvers.Ros34PW2())
        return run.position("rocker")[-1, 2]

    derivative, height = jax.jit(jax.jacfwd(height)), jax.jit(height)
    k = 1e6
    difference = (height(1.02 * k, 1e-8) - height(0.98 * k, 1e-8)) / (0.04 * k)
    errors = [abs(float(derivative(k, tol) / difference) - 1) for tol in (1e-5, 1e-8)]
    assert errors[0] < 0.5
    assert errors[1] < 0.01
