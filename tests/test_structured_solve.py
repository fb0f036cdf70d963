"""The linear systems of Rosenbrock steps in a mechanism's own structure: exact, sparse, differentiable."""

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.loop_fusion import fuse_loops
from spherejax.foundations.lanes import in_lanes
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.implicit_rows import solver_of_rows
from spherejax.motion.integration.jobs import RunNumbers
from spherejax.motion.integration.problem import Parameters
from spherejax.motion.integration.sensitivity_rows import linearized
from spherejax.motion.solvers.implicit import systems_of, with_structure
from spherejax.motion.start.assembly import as_ideal, assemble_now

MODELS = {
    "ideal": sj.Ideal(),
    "friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "bristles": sj.Dry(1e-4, friction=sj.LuGre()),
    "film": sj.Lubricated(1e-4),
    "bushing": sj.Bushing(
        law=sj.laws.MatrixElastomer.cylindrical(
            (0.1, 0.2, 1.0),
            radial_stiffness=1e5,
            axial_stiffness=3e4,
            conical_stiffness=2.0,
            torsional_stiffness=0.5,
            damping=1e-3,
        )
    ),
}
GAMMA_H = 2e-5


class Push(sj.forces.AbstractForce):
    """A force that swings with time."""

    body: str = eqx.field(static=True)
    amplitude: float

    def wrenches(self, t, motions):
        force = self.amplitude * jnp.array([jnp.sin(300.0 * t), 0.0, jnp.cos(200.0 * t)])
        return {self.body: sj.forces.Wrench(force, jnp.cross(motions[self.body].rotation[:, 0], force))}


def four_bar(model, **options):
    scene = sj.gallery.four_bar(model)
    return sj.Scene(
        scene.bodies, scene.joints, options.pop("forces", {}), gravity=(0.0, 0.0, -9.81),
        ground_points=scene.ground_points, **options,
    )  # fmt: skip


def states_of(system):
    """States near the start, off the constraints and the unit sphere: in flight and in contact by turns."""
    start = assemble_now(*flatten_system(as_ideal(system)))
    rng = np.random.default_rng(0)
    layout = system.layout
    states = []
    for seed, distance in enumerate((0.2 * cases.C, 2 * cases.C) * 2):
        y = cases.displaced_state(system, start, seed, distance)
        y[: layout.memory_start] *= 1 + 1e-4 * rng.normal(size=layout.memory_start)
        if layout.n_memory and distance < cases.C:
            y[layout.memory_start] = 0.0  # no onset yet
        states.append(jnp.asarray(y))
    return states


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in ("friction", "bushing", "bristles"))) for name in MODELS],
)
def test_structured_solution_equals_the_dense_one(name):
    """The dense one has its Jacobian by differentiation of the whole right-hand side.

    But for the row of the work of the constraint forces, on which nothing depends: it is left out of the matrix.
    """
    scene = four_bar(MODELS[name], forces={"push": Push("rocker", 3.0)})
    system = compile_scene(scene, track_work=name == "film").system
    structure, theta = flatten_system(system)
    theta, t = jnp.asarray(theta), jnp.asarray(0.01)
    rate = program_for(state_rate, structure)
    systems = systems_of(structure)

    @jax.jit
    def structured(y, rhs):
        at, _ = systems.jacobian(t, y, Parameters(theta, rate.ahead(theta)))
        solve, regular = systems.factorize(at, jnp.asarray(GAMMA_H))
        return solve(rhs), regular

    def dense(y, rhs):
        with jax.disable_jit():  # a fifth of a second, and nothing to compile
            J = np.array(jax.jacfwd(lambda y: rate(theta, t, y))(y))
        if system.tracks_constraint_work:
            J[system.constraint_work_index] = 0.0
        return np.linalg.solve(np.eye(y.size) - GAMMA_H * J, rhs)

    right_hand_sides = np.random.default_rng(1).normal(size=(4, system.layout.size))
    if system.layout.n_memory:
        right_hand_sides[:, system.layout.memory_start] = 0.0  # the onset rate has no rate
    for y, rhs in zip(states_of(system), right_hand_sides, strict=True):
        found, regular = structured(y, rhs)
        expected = dense(y, rhs)
        assert bool(regular)
        np.testing.assert_allclose(found, expected, rtol=2e-8, atol=1e-9 * np.abs(expected).max())


def test_derivative_by_time_of_a_driven_mechanism():
    system = compile_scene(four_bar(sj.Ideal(), forces={"push": Push("rocker", 3.0)})).system
    structure, theta = flatten_system(system)
    rate = program_for(state_rate, structure)
    y = states_of(system)[1]
    args = Parameters(jnp.asarray(theta), rate.ahead(jnp.asarray(theta)))
    by_time = jax.jit(lambda t: systems_of(structure).jacobian(t, y, args)[1])(0.01)
    step = 1e-6
    differences = (rate(theta, 0.01 + step, y) - rate(theta, 0.01 - step, y)) / (2 * step)
    assert float(jnp.max(jnp.abs(by_time))) > 1.0
    np.testing.assert_allclose(by_time, differences, atol=1e-6 * float(jnp.max(jnp.abs(by_time))))


@pytest.mark.slow
def test_a_run_takes_the_steps_of_the_dense_method():
    scene, ts = sj.gallery.four_bar(sj.Lubricated(1e-4)), jnp.linspace(0.0, 0.03, 4)
    structured = sj.simulate(scene, ts, rtol=1e-7, solver=sj.solvers.Rodas5P())
    # A function of its own as factorization keeps the solver from being given the mechanism's structure.
    dense_solver = sj.solvers.Rodas5P(jacobian=dense_jacobian(scene))
    dense = sj.simulate(scene, ts, rtol=1e-7, solver=dense_solver)
    assert abs(int(structured.stats.n_steps) - int(dense.stats.n_steps)) <= 0.02 * int(dense.stats.n_steps)
    np.testing.assert_allclose(structured.ys, dense.ys, rtol=1e-5, atol=1e-8)


def dense_jacobian(scene):
    structure, _ = flatten_system(compile_scene(scene).system)
    rate = program_for(state_rate, structure, False)  # compiles faster

    def jacobian(t, y, args):
        return jax.jacfwd(lambda y: rate(args.theta, t, y))(y), jnp.zeros_like(y)

    return jacobian


@pytest.mark.slow
def test_derivatives_pass_through_the_structured_solve():
    """By the numbers and by the state, against differences, with the rule that never enters the elimination."""
    # Linear in the deflection, so that differences may be wide.
    scene = four_bar(sj.Bushing(law=sj.laws.VectorElastomer(1e5, 1e-3)))
    system = compile_scene(scene).system
    structure, theta = flatten_system(system)
    systems = systems_of(structure)
    y = states_of(system)[1]
    rng = np.random.default_rng(2)
    theta, rhs = jnp.asarray(theta), jnp.asarray(rng.normal(size=y.shape))
    # Numbers that are structural zeros are no numbers: the others move in proportion.
    theta_dot, y_dot = 1e-2 * theta * rng.normal(size=theta.shape), 1e-2 * jnp.asarray(rng.normal(size=y.shape))

    def moved(s):
        numbers = theta + s * theta_dot
        at, _ = systems.jacobian(jnp.zeros(()), y + s * y_dot, Parameters(numbers, systems.rate.ahead(numbers)))
        return systems.factorize(at, GAMMA_H * (1 + s))[0](rhs * (1 + 2 * s))

    along = jax.jit(lambda s: jax.jvp(moved, (s,), (1.0,)))  # one program for the values and the derivative
    h = 1e-3
    before, close_before, close_after, after = (along(s)[0] for s in (-2 * h, -h, h, 2 * h))
    differences = (8 * (close_after - close_before) - (after - before)) / (12 * h)
    tangent = along(0.0)[1]
    # The matrix leaves out the row of the work of the constraint forces, and the rule does not: of that entry alone, on
    # which nothing depends, the derivative is that of the whole Jacobian.
    assert system.tracks_constraint_work
    tangent, differences = (np.delete(x, system.constraint_work_index) for x in (tangent, differences))
    np.testing.assert_allclose(tangent, differences, rtol=1e-6, atol=1e-7 * np.max(np.abs(differences)))


def test_only_rosenbrock_methods_without_a_jacobian_get_the_structure():
    import diffrax

    structure, _ = flatten_system(compile_scene(sj.gallery.four_bar(sj.Ideal())).system)
    explicit, own = diffrax.Dopri8(), sj.solvers.Rodas5P(jacobian=lambda t, y, args: (jnp.eye(2), jnp.zeros(2)))
    assert with_structure(explicit, structure) is explicit
    assert with_structure(own, structure) is own
    assert with_structure(sj.solvers.Rodas4P(), structure).jacobian is not None


STEPS = [
    *(
        (method, "film", n_rows)
        for method in (sj.solvers.Rodas5P, sj.solvers.Rodas4P, sj.solvers.Ros34PW2)
        for n_rows in (0, 2)
    ),
    *((sj.solvers.Rodas5P, "film", n_rows) for n_rows in (1, 3, 9)),
    *((method, "pushed", n_rows) for method in (sj.solvers.Rodas5P, sj.solvers.Ros34PW2) for n_rows in (0, 2)),
    *((sj.solvers.Rodas5P, name, n_rows) for name in ("ideal", "bristles", "friction in a joint") for n_rows in (0, 2)),
    *((sj.solvers.Ros34PW2, name, 2) for name in ("bristles", "bushing")),
]
"""Methods, models and numbers of sensitivities whose steps are made in one call, and stage by stage."""


@pytest.mark.parametrize(
    ("method", "name", "n_rows"),
    [pytest.param(*step, marks=[] if step[1] == "film" and step[2] < 3 else [pytest.mark.slow]) for step in STEPS],
)
@pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")
def test_a_step_in_one_call_is_that_of_the_loop(method, name, n_rows):
    """State, sensitivities, error estimate and dense output; time, numbers and state all matter."""
    step, theta, y, y_dot = step_of(method, name, n_rows)
    expected = jax.jit(step)(theta, y)
    with machine_code.native_code(), machine_code.record_ffi_targets() as codes:
        found = jax.jit(fuse_loops(step))(theta, y)
        traced = str(jax.make_jaxpr(lambda *given: step(*given))(theta, y))
    assert codes()
    assert "runge_kutta_step" in traced
    begin = jnp.concatenate([y[None], y_dot])
    size = 1e-9 * np.max(np.abs(jnp.atleast_2d(expected[0]) - begin), axis=1)  # of rounding, in what cancels
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(
            jnp.atleast_2d(one) / size[:, None], jnp.atleast_2d(other) / size[:, None], 1e-7, 1.0
        )


@pytest.mark.parametrize(
    ("method", "name", "n_rows", "n_runs"),
    [
        pytest.param(*case, marks=[] if case[2] < 3 and case[3] < 9 else [pytest.mark.slow])
        for case in [
            *((sj.solvers.Rodas5P, "film", n_rows, n_runs) for n_rows in (0, 1, 2, 3) for n_runs in (3, 9)),
            *((sj.solvers.Rodas5P, name, 2, 11) for name in ("pushed", "bristles", "friction in a joint")),
            (sj.solvers.Ros34PW2, "bushing", 2, 11),
        ]
    ],
)
@pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")
def test_steps_of_many_runs_in_one_call_are_those_of_each(method, name, n_rows, n_runs):
    """Groups of runs as vectors, of which the last ones overlap; each with numbers and a state of its own."""
    step, theta, y, y_dot = step_of(method, name, n_rows)
    thetas = theta * (1 + 1e-3 * jnp.arange(n_runs)[:, None])
    ys = y * (1 + 1e-7 * jnp.arange(n_runs)[:, None])
    expected = jax.lax.map(lambda given: step(*given), (thetas, ys))
    with machine_code.native_code(), machine_code.record_ffi_targets() as codes:
        found = jax.jit(fuse_loops(lambda *given: in_lanes(step)(*given)))(thetas.T, ys.T)
    assert codes()
    found = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), found)
    begin = jnp.concatenate([y[None], y_dot])
    size = 1e-9 * np.max(np.abs(jnp.atleast_2d(expected[0][0]) - begin), axis=1)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        scale = size if n_rows else size[0]
        shape = (n_runs, -1, *((len(size),) if n_rows else ()), y.size)
        np.testing.assert_allclose(
            one.reshape(shape) / np.reshape(scale, (-1, 1)),
            other.reshape(shape) / np.reshape(scale, (-1, 1)),
            1e-7,
            1.0,
        )


def step_of(method, name, n_rows):
    """A step as a function of the numbers and the state, both, and the sensitivities."""
    models = {**MODELS, "pushed": sj.Lubricated(1e-4), "friction in a joint": sj.Ideal(sj.Threlfall(), 0.01)}
    forces = {"push": Push("rocker", 3.0)} if name == "pushed" else {}
    system = compile_scene(four_bar(models[name], forces=forces)).system
    structure, theta = flatten_system(system)
    rate, theta = program_for(state_rate, structure), jnp.asarray(theta)
    y = states_of(system)[0]
    t0, h = jnp.asarray(0.3), jnp.asarray(1e-5)
    mixed = np.random.default_rng(0).normal(size=(n_rows, theta.size + y.size))
    theta_dot, y_dot = 1e-2 * theta * mixed[:, : theta.size], 1e-3 * jnp.asarray(mixed[:, theta.size :])
    term = diffrax.ODETerm(lambda t, y, args: rate.inside(args.theta, args.ahead, t, y))

    def step(theta, y):
        if not n_rows:
            parameters, solver = Parameters(theta, rate.ahead(theta)), with_structure(method(), structure)
            found = solver.step(term, t0, t0 + h, y, parameters, None, jnp.array(False))
        else:
            value, slopes = linearized(lambda theta: Parameters(theta, rate.ahead(theta)), theta, theta_dot)
            rows = jnp.concatenate([y[None], y_dot])
            solver = solver_of_rows(method(), structure, rate)
            parameters = RunNumbers(value, slopes, None, None)
            found = solver.step(term, t0, t0 + h, rows, parameters, None, jnp.array(False))
        return found[0], found[1], found[2]["bends"]

    return step, theta, y, y_dot
