"""Rodas4P and Rodas5P: coefficients, orders, published stiff problems, transformations, edge cases."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.motion.solvers.dense_lu import dense_solver
from spherejax.motion.solvers.rosenbrock import Rodas4P, Rodas5P, factorize_dense
from spherejax.motion.solvers.rosenbrock_tableaus import RODAS4P, RODAS5P

jax.config.update("jax_enable_x64", True)

SOLVERS = pytest.mark.parametrize("solver", [Rodas4P(), Rodas5P()], ids=["Rodas4P", "Rodas5P"])
TABLEAUS = pytest.mark.parametrize("tableau", [RODAS4P, RODAS5P], ids=["Rodas4P", "Rodas5P"])


def integrate(field, solver, t0, t1, y0, args=None, *, n_steps=None, rtol=1e-8, atol=None, saveat=None, adjoint=None):
    """With `n_steps` equal steps, or adaptively from a small first step; atol None: as rtol."""
    fixed = n_steps is not None
    # Arrays, so that other times and tolerances do not compile again.
    numbers = (
        t0,
        t1,
        (t1 - t0) / n_steps if fixed else np.copysign(1e-6, t1 - t0),
        rtol,
        rtol if atol is None else atol,
    )
    saveat = diffrax.SaveAt(t1=True) if saveat is None else saveat
    adjoint = diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    return _integrate(field, solver, *map(jnp.asarray, numbers), y0, args, saveat, adjoint, fixed)


@eqx.filter_jit
def _integrate(field, solver, t0, t1, dt0, rtol, atol, y0, args, saveat, adjoint, fixed):
    controller = diffrax.ConstantStepSize() if fixed else diffrax.PIDController(rtol=rtol, atol=atol)
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        t0,
        t1,
        dt0,
        y0,
        args,
        stepsize_controller=controller,
        saveat=saveat,
        adjoint=adjoint,
        max_steps=20_000,
    )


def smooth(t, y, args):
    """Nonlinear and explicitly dependent on time."""
    return jnp.array([y[1] * jnp.cos(t), -y[0] * y[1] + jnp.sin(2 * t)])


def slopes(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


# Coefficients


def classical(tableau):
    """Weights, alpha, Gamma, and beta = alpha + Gamma, of Hairer & Wanner, section IV.7."""
    Gamma = np.linalg.inv(np.eye(len(tableau.c)) / tableau.gamma - tableau.C)
    alpha = tableau.A @ Gamma
    return tableau.b @ Gamma, alpha, Gamma, alpha + Gamma


@TABLEAUS
def test_abscissae_and_time_coefficients_are_row_sums(tableau):
    _, alpha, Gamma, _ = classical(tableau)
    np.testing.assert_allclose(alpha.sum(1), tableau.c, atol=1e-12)
    np.testing.assert_allclose(Gamma.sum(1), tableau.d, atol=1e-12)
    np.testing.assert_allclose(np.diag(Gamma), tableau.gamma, rtol=1e-14)


@TABLEAUS
def test_order_conditions_up_to_four(tableau):
    b, alpha, _, beta = classical(tableau)
    a, B = alpha.sum(1), beta.sum(1)
    conditions = {
        "1": (b.sum(), 1),
        "2": (b @ B, 1 / 2),
        "3a": (b @ a**2, 1 / 3),
        "3b": (b @ beta @ B, 1 / 6),
        "4a": (b @ a**3, 1 / 4),
        "4b": ((b * a) @ alpha @ B, 1 / 8),
        "4c": (b @ beta @ a**2, 1 / 12),
        "4d": (b @ beta @ beta @ B, 1 / 24),
    }
    for name, (value, wanted) in conditions.items():
        np.testing.assert_allclose(value, wanted, atol=1e-10, err_msg=name)


def test_order_conditions_five_of_rodas5p():
    b, alpha, _, beta = classical(RODAS5P)
    a, B = alpha.sum(1), beta.sum(1)
    conditions = [
        (b @ a**4, 1 / 5),
        ((b * a**2) @ alpha @ B, 1 / 10),
        (b @ (alpha @ B) ** 2, 1 / 20),
        ((b * a) @ alpha @ a**2, 1 / 15),
        ((b * a) @ alpha @ beta @ B, 1 / 30),
        (b @ beta @ a**3, 1 / 20),
        (b @ beta @ (a * (alpha @ B)), 1 / 40),
        (b @ beta @ beta @ a**2, 1 / 60),
        (b @ beta @ beta @ beta @ B, 1 / 120),
    ]
    for value, wanted in conditions:
        np.testing.assert_allclose(value, wanted, atol=1e-10)


@TABLEAUS
def test_stiffly_accurate_and_l_stable(tableau):
    b, _, _, beta = classical(tableau)
    np.testing.assert_allclose(beta[-1], b, atol=1e-11)
    np.testing.assert_allclose(1 - b @ np.linalg.solve(beta, np.ones(len(b))), 0.0, atol=1e-9)


@TABLEAUS
def test_stability_function_is_bounded_by_one_on_the_imaginary_axis(tableau):
    b, _, _, beta = classical(tableau)
    ones = np.ones(len(b))
    for z in 1j * np.logspace(-2, 6, 200):
        assert abs(1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * beta, ones)) < 1 + 1e-9


# Orders observed


@pytest.fixture(scope="module")
def smooth_solution():
    return integrate(
        smooth,
        diffrax.Dopri8(),
        0.0,
        2.0,
        jnp.array([1.0, 0.5]),
        rtol=1e-13,
        saveat=diffrax.SaveAt(ts=jnp.linspace(0, 2, 41)),
    ).ys


@SOLVERS
def test_order_of_steps(solver, smooth_solution):
    y0 = jnp.array([1.0, 0.5])
    errors = [
        float(jnp.abs(integrate(smooth, solver, 0.0, 2.0, y0, n_steps=n).ys[0] - smooth_solution[-1]).max())
        for n in (20, 40, 80)
    ]
    np.testing.assert_allclose(slopes(errors), solver.tableau.order, atol=0.2)


@SOLVERS
def test_order_of_error_estimate(solver):
    """The estimate of one step is that of a method of order p - 1: it scales with h^p."""
    term = diffrax.ODETerm(smooth)
    step = jax.jit(lambda h: solver.step(term, 0.3, 0.3 + h, jnp.array([1.0, 0.5]), None, None, False)[1])
    errors = [float(jnp.linalg.norm(step(h))) for h in (0.008, 0.004, 0.002)]
    np.testing.assert_allclose(slopes(errors), solver.tableau.order, atol=0.2)
    assert solver.error_order(term) == solver.tableau.order


@SOLVERS
def test_order_of_dense_output(solver, smooth_solution):
    """Within a single step the dense output of order p - 1 errs by O(h^p)."""
    term = diffrax.ODETerm(smooth)
    y0 = jnp.array([1.0, 0.5])

    @jax.jit
    def within(h):
        dense = solver.step(term, 0.0, h, y0, None, None, False)[2]
        return solver.interpolation_cls(t0=jnp.array(0.0), t1=h, **dense).evaluate(0.4 * h)

    errors = []
    for h in (0.1, 0.05, 0.025):
        between = within(h)
        exact = integrate(smooth, diffrax.Dopri8(), 0.0, 0.4 * h, y0, rtol=1e-14).ys[0]
        errors.append(float(jnp.abs(between - exact).max()))
    np.testing.assert_allclose(slopes(errors), solver.tableau.order, atol=0.35)
    ts = jnp.linspace(0, 2, 41)
    saved = integrate(smooth, solver, 0.0, 2.0, y0, rtol=1e-9, saveat=diffrax.SaveAt(ts=ts)).ys
    np.testing.assert_allclose(saved, smooth_solution, atol=1e-7)


def test_dense_output_passes_through_both_ends_and_gives_increments():
    y0 = jnp.array([1.0, 0.5])
    y1, _, dense, _, _ = Rodas5P().step(diffrax.ODETerm(smooth), 0.0, 0.1, y0, None, None, False)
    path = Rodas5P.interpolation_cls(t0=jnp.array(0.0), t1=jnp.array(0.1), **dense)
    np.testing.assert_allclose(path.evaluate(0.0), y0, rtol=1e-15)
    np.testing.assert_allclose(path.evaluate(0.1), y1, rtol=1e-15)
    np.testing.assert_allclose(path.evaluate(0.0, 0.1), y1 - y0, rtol=1e-13)


# Stiff problems


@SOLVERS
def test_prothero_robinson_keeps_order_three(solver):
    """y' = lambda (y - g) + g', lambda = -1e6: what remains of the error is of size h^3 / |lambda|.

    Source: A. Prothero, A. Robinson, Mathematics of Computation 28 (1974) 145.
    """
    steps = np.array([4, 8, 16])
    errors = []
    for n in steps:
        y = integrate(prothero_robinson, solver, 0.5, 2.5, jnp.sin(jnp.array([0.5])), n_steps=n).ys[0]
        errors.append(float(jnp.abs(y - jnp.sin(2.5))[0]))
    assert (np.array(errors) < 0.02 * (2.0 / steps) ** 3 / 1e6).all()
    assert slopes(errors).min() > 2.8


def prothero_robinson(t, y, args):
    return -1e6 * (y - jnp.sin(t)) + jnp.cos(t)


def van_der_pol(t, y, epsilon):
    return jnp.array([y[1], ((1 - y[0] ** 2) * y[1] - y[0]) / epsilon])


def hires(t, y, args):
    y1, y2, y3, y4, y5, y6, y7, y8 = y
    exchange = 280 * y6 * y8 - 1.81 * y7
    return jnp.array(
        [
            -1.71 * y1 + 0.43 * y2 + 8.32 * y3 + 0.0007,
            1.71 * y1 - 8.75 * y2,
            -10.03 * y3 + 0.43 * y4 + 0.035 * y5,
            8.32 * y2 + 1.71 * y3 - 1.12 * y4,
            -1.745 * y5 + 0.43 * y6 + 0.43 * y7,
            -280 * y6 * y8 + 0.69 * y4 + 1.71 * y5 - 0.43 * y6 + 0.69 * y7,
            exchange,
            -exchange,
        ]
    )


def robertson(t, y, args):
    y1, y2, y3 = y
    first, second, third = 0.04 * y1, 1e4 * y2 * y3, 3e7 * y2**2
    return jnp.array([-first + second, first - second - third, third])


PUBLISHED = {
    "van der Pol": (
        van_der_pol,
        2.0,
        [2.0, 0.0],
        1e-6,
        [1.706167732170483, -0.8928097010247975],
        1.0,
    ),
    "HIRES": (
        hires,
        321.8122,
        [1.0, 0, 0, 0, 0, 0, 0, 0.0057],
        None,
        [
            0.7371312573325668e-3,
            0.1442485726316185e-3,
            0.5888729740967575e-4,
            0.1175651343283149e-2,
            0.2386356198831331e-2,
            0.6238968252742796e-2,
            0.2849998395185769e-2,
            0.2850001604814231e-2,
        ],
        1e-4,
    ),
    "ROBER": (
        robertson,
        1e11,
        [1.0, 0.0, 0.0],
        None,
        [0.2083340149701255e-7, 0.8333360770334713e-13, 0.9999999791665050],
        1e-10,
    ),
}
"""Field, end, start, args, published end state, atol / rtol.

Source: F. Mazzia, C. Magherini, Test set for IVP solvers, release 2.4, 2008.
"""


@SOLVERS
@pytest.mark.parametrize("name", list(PUBLISHED))
def test_published_stiff_problems(solver, name):
    field, t1, y0, args, wanted, absolute = PUBLISHED[name]
    errors = []
    for rtol in (1e-5, 1e-7, 1e-9):
        solution = integrate(field, solver, 0.0, t1, jnp.array(y0), args, rtol=rtol, atol=rtol * absolute)
        errors.append(float(jnp.max(jnp.abs(solution.ys[0] / jnp.array(wanted) - 1))))
    assert errors[0] < 1e-2
    assert errors[2] < 1e-6
    assert errors[2] < errors[0] / 50


# Transformations


def decay(t, y, rate):
    """A stiff pair, explicitly dependent on time."""
    return jnp.array([-rate * (y[0] - jnp.cos(t)), y[0] * y[1] * jnp.sin(rate * 1e-3 * t)])


def final_state(rate, solver=None, adjoint=None):
    solver = Rodas5P() if solver is None else solver
    return integrate(decay, solver, 0.0, 1.0, jnp.array([0.0, 1.0]), rate, rtol=1e-9, adjoint=adjoint).ys[0]


def test_vmap_equals_loop():
    rates = jnp.array([1e1, 1e3, 1e5])
    together = jax.vmap(final_state)(rates)
    np.testing.assert_allclose(together, jnp.stack([final_state(r) for r in rates]), rtol=1e-12)


def test_forward_reverse_and_differences_agree():
    solver, rate, step = Rodas5P(), 200.0, 1e-2
    forward = jax.jit(jax.jacfwd(lambda r: final_state(r, solver, diffrax.ForwardMode())))(rate)
    reverse = jax.jit(jax.jacrev(lambda r: final_state(r, solver, diffrax.RecursiveCheckpointAdjoint())))(rate)
    difference = (final_state(rate + step, solver) - final_state(rate - step, solver)) / (2 * step)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    np.testing.assert_allclose(forward, difference, rtol=1e-4, atol=1e-10)


def test_pytree_state():
    def field(t, y, args):
        return {"angle": y["speed"], "speed": -50.0 * jnp.sin(y["angle"])}

    def flat(t, y, args):
        tree = field(t, {"angle": y[:2].reshape(1, 2), "speed": y[2:].reshape(1, 2)}, args)
        return jnp.concatenate([tree["angle"].ravel(), tree["speed"].ravel()])

    y0 = {"angle": jnp.array([[1.0, 1.0]]), "speed": jnp.zeros((1, 2))}
    saveat = diffrax.SaveAt(ts=jnp.linspace(0, 1, 7))
    tree = integrate(field, Rodas5P(), 0.0, 1.0, y0, saveat=saveat).ys
    array = integrate(flat, Rodas5P(), 0.0, 1.0, jnp.array([1.0, 1.0, 0, 0]), saveat=saveat).ys
    np.testing.assert_allclose(tree["angle"].reshape(7, 2), array[:, :2], rtol=1e-12)
    np.testing.assert_allclose(tree["speed"].reshape(7, 2), array[:, 2:], rtol=1e-12, atol=1e-14)


def test_scalar_state():
    solution = integrate(lambda t, y, a: -1e4 * (y - jnp.cos(t)), Rodas4P(), 0.0, 1.0, jnp.array(0.0))
    assert solution.ys.shape == (1,)
    np.testing.assert_allclose(solution.ys[0], (jnp.cos(1.0) + 1e-4 * jnp.sin(1.0)), rtol=1e-7)


def test_single_precision_state_keeps_its_type():
    term = diffrax.ODETerm(lambda t, y, args: smooth(t, y, args).astype(y.dtype))
    single, double = (
        Rodas5P().step(term, 0.0, 0.1, jnp.array([1.0, 0.5], dtype), None, None, False)[:2]
        for dtype in (jnp.float32, jnp.float64)
    )
    assert single[0].dtype == single[1].dtype == jnp.float32
    np.testing.assert_allclose(single[0], double[0], rtol=1e-6)


@SOLVERS
def test_backward_in_time_returns_to_the_start(solver):
    y0 = jnp.array([1.0, 0.5])
    end = integrate(smooth, solver, 0.0, 2.0, y0, rtol=1e-10).ys[0]
    np.testing.assert_allclose(integrate(smooth, solver, 2.0, 0.0, end, rtol=1e-10).ys[0], y0, rtol=1e-7)


# Hooks


def supplied(t, y, args):
    jacobian = jnp.array([[0.0, jnp.cos(t)], [-y[1], -y[0]]])
    return jacobian, jnp.array([-y[1] * jnp.sin(t), 2 * jnp.cos(2 * t)])


@pytest.mark.parametrize(("t0", "t1"), [(0.0, 2.0), (2.0, 0.0)])
def test_supplied_jacobian_and_factorization(t0, t1):
    def factorize(jacobian, gamma_h):
        """The second unknown eliminated by hand."""
        (a, b), (c, d) = jnp.eye(2) - gamma_h * jacobian
        determinant = a * d - b * c
        return (
            lambda rhs: jnp.array([d * rhs[0] - b * rhs[1], a * rhs[1] - c * rhs[0]]) / determinant,
            determinant != 0,
        )

    y0 = jnp.array([1.0, 0.5])
    wanted = integrate(smooth, Rodas5P(), t0, t1, y0, n_steps=20).ys
    for solver in (Rodas5P(jacobian=supplied), Rodas5P(jacobian=supplied, factorize=factorize)):
        np.testing.assert_allclose(integrate(smooth, solver, t0, t1, y0, n_steps=20).ys, wanted, rtol=1e-12)


def test_number_of_passes_does_not_matter():
    y0 = jnp.array(PUBLISHED["HIRES"][2])
    wanted = integrate(hires, Rodas5P(), 0.0, 5.0, y0, n_steps=20).ys
    solver = Rodas5P(tangents_per_pass=4)
    np.testing.assert_allclose(integrate(hires, solver, 0.0, 5.0, y0, n_steps=20).ys, wanted, rtol=1e-11)


# The dense solver and singular matrices


@pytest.mark.parametrize("n", [1, 7, 40])
def test_dense_solver_against_lapack(n):
    rng = np.random.default_rng(n)
    matrix, rhs = rng.normal(size=(3, n, n)), rng.normal(size=(3, n))
    matrix[:, 0, 0] = 0.0 if n > 1 else 1.0  # needs a row exchange

    def solve(A, b):
        return dense_solver(A)[0](b)

    def reference(A, b):
        return jnp.linalg.solve(A, b)

    np.testing.assert_allclose(jax.jit(jax.vmap(solve))(matrix, rhs), jax.vmap(reference)(matrix, rhs), rtol=1e-8)
    if n < 10:
        for jacobian in (jax.jacfwd, jax.jacrev):
            for ours, theirs in zip(
                jax.jit(jacobian(solve, (0, 1)))(matrix[0], rhs[0]),
                jax.jit(jacobian(reference, (0, 1)))(matrix[0], rhs[0]),
                strict=True,
            ):
                np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.ones((3, 3)), np.full((3, 3), np.nan)])
def test_singular_matrix_is_reported(matrix):
    solve, regular = dense_solver(jnp.asarray(matrix))
    assert not bool(regular)
    assert np.isfinite(matrix).all() == bool(jnp.isfinite(solve(jnp.ones(3))).all())


def test_singular_step_has_infinite_error_and_is_rejected():
    """y' = y / gamma with h = 1: I - gamma h J is exactly zero."""
    growth = diffrax.ODETerm(lambda t, y, k: k * y)
    solver, k = Rodas4P(), 4.0
    y1, error, _, _, _ = solver.step(growth, 0.0, 1.0, jnp.array([1.0]), k, None, False)
    assert np.isfinite(y1).all()
    assert np.isposinf(error).all()

    def grown(k):
        return diffrax.diffeqsolve(
            growth,
            solver,
            0.0,
            1.5,
            1.0,
            jnp.array([1.0]),
            k,
            stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8),
        )

    solution = grown(k)
    assert int(solution.stats["num_rejected_steps"]) >= 1
    np.testing.assert_allclose(solution.ys[0], np.exp(1.5 * k), rtol=1e-6)
    # The derivative passes the rejected step without harm.
    np.testing.assert_allclose(jax.grad(lambda k: grown(k).ys[0, 0])(k), 1.5 * np.exp(1.5 * k), rtol=1e-5)


def test_undefined_field_rejects_the_step():
    """y' = -sqrt(y) leaves its domain in a first step that is too long."""
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, a: -jnp.sqrt(y)),
        Rodas5P(),
        0.0,
        1.0,
        50.0,
        jnp.array([1.0]),
        stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8, dtmax=50.0),
        saveat=diffrax.SaveAt(t1=True),
    )
    np.testing.assert_allclose(solution.ys[0], 0.25, rtol=1e-6)


def test_factorization_is_not_traced_by_derivatives():
    """The pivot search would otherwise enter the derivative; W = 2 I here, dx = -dW x / 2."""
    tangent = jax.jvp(
        lambda j: factorize_dense(-jnp.eye(2) + j, jnp.array(1.0))[0](jnp.ones(2)),
        (jnp.zeros((2, 2)),),
        (jnp.eye(2),),
    )[1]
    np.testing.assert_allclose(tangent, [0.25, 0.25])
