"""The linear systems of Rosenbrock steps in a mechanism's own structure: exact, sparse, differentiable."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.dynamics import state_rate
from spherejax.motion.implicit import hooks_of, with_structure
from spherejax.motion.integrate import Parameters
from spherejax.motion.programs import program_for

MODELS = {
    "ideal": sj.Ideal(),
    "friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "bristles": sj.Dry(1e-4, friction=sj.LuGre()),
    "film": sj.Lubricated(1e-4),
    "bushing": sj.Bushing(
        law=sj.MatrixElastomer.cylindrical(
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


class Push(sj.AbstractForce):
    """A force that swings with time."""

    body: str = eqx.field(static=True)
    amplitude: float

    def wrenches(self, t, motions):
        force = self.amplitude * jnp.array([jnp.sin(300.0 * t), 0.0, jnp.cos(200.0 * t)])
        return {self.body: sj.Wrench(force, jnp.cross(motions[self.body].rotation[:, 0], force))}


def four_bar(model, **options):
    scene = sj.gallery.four_bar(model)
    return sj.Scene(
        scene.bodies, scene.joints, options.pop("forces", {}), gravity=(0.0, 0.0, -9.81),
        ground_points=scene.ground_points, **options,
    )  # fmt: skip


def compared(system, t, y, rhs, rate):
    """The structured solution and a dense one, with the Jacobian by differentiation of the whole right-hand side."""
    structure, theta = flatten_system(system)
    theta = jnp.asarray(theta)
    jacobian, factorize = hooks_of(structure)
    at, by_time = jacobian(t, y, Parameters(theta, rate.ahead(theta)))
    solve, regular = factorize(at, jnp.asarray(GAMMA_H))
    J = jax.jacfwd(lambda y: rate(theta, t, y))(y)
    dense = jnp.linalg.solve(jnp.eye(y.shape[0]) - GAMMA_H * J, rhs)
    return solve(rhs), dense, by_time, regular


def states_of(scene, system, n):
    """States on a motion, moved off the constraints and the unit sphere, with the memory of a contact."""
    rng = np.random.default_rng(0)
    run = sj.simulate(scene, jnp.linspace(0.0, 0.03, n), rtol=1e-6)
    layout = system.layout
    y = np.array(run.ys)
    y[:, : layout.memory_start] *= 1 + 1e-4 * rng.normal(size=(n, layout.memory_start))
    if layout.n_memory:
        y[1::2, layout.memory_start] = 0.01  # in contact
    return jnp.asarray(y)


@pytest.mark.parametrize("name", MODELS)
def test_structured_solution_equals_the_dense_one(name):
    scene = four_bar(MODELS[name], forces={"push": Push("rocker", 3.0)})
    system = compile_scene(scene, track_work=True).system if name == "film" else compile_scene(scene).system
    structure, _ = flatten_system(system)
    rate = program_for(state_rate, structure)
    layout = system.layout
    ys = states_of(scene, compile_scene(scene).system, 4)
    ys = jnp.concatenate([ys, jnp.zeros((4, layout.size - ys.shape[1]))], 1)
    rhs = np.random.default_rng(1).normal(size=(4, layout.size))
    if layout.n_memory:
        rhs[:, layout.memory_start] = 0.0  # the onset rate has no rate
    solve = jax.jit(lambda y, r: compared(system, jnp.asarray(0.01), y, r, rate))
    for y, r in zip(ys, rhs, strict=True):
        structured, dense, _, regular = solve(y, jnp.asarray(r))
        assert bool(regular)
        np.testing.assert_allclose(structured, dense, rtol=2e-8, atol=1e-9 * float(jnp.max(jnp.abs(dense))))


def test_derivative_by_time_of_a_driven_mechanism():
    system = compile_scene(four_bar(sj.Ideal(), forces={"push": Push("rocker", 3.0)})).system
    structure, theta = flatten_system(system)
    rate = program_for(state_rate, structure)
    y = sj.simulate(four_bar(sj.Ideal()), jnp.array([0.0, 0.05])).ys[-1]
    args = Parameters(jnp.asarray(theta), rate.ahead(jnp.asarray(theta)))
    by_time = jax.jit(lambda t: hooks_of(structure)[0](t, y, args)[1])(0.01)
    step = 1e-6
    differences = (rate(theta, 0.01 + step, y) - rate(theta, 0.01 - step, y)) / (2 * step)
    assert float(jnp.max(jnp.abs(by_time))) > 1.0
    np.testing.assert_allclose(by_time, differences, atol=1e-6 * float(jnp.max(jnp.abs(by_time))))


def test_a_run_takes_the_steps_of_the_dense_method(monkeypatch):
    scene, ts = sj.gallery.four_bar(sj.Lubricated(1e-4)), jnp.linspace(0.0, 0.03, 4)
    structured = sj.simulate(scene, ts, rtol=1e-7, solver=sj.Rodas5P())
    # A function of its own as factorization keeps the solver from being given the mechanism's structure.
    dense_solver = sj.Rodas5P(jacobian=dense_jacobian(scene))
    dense = sj.simulate(scene, ts, rtol=1e-7, solver=dense_solver)
    assert abs(int(structured.stats.n_steps) - int(dense.stats.n_steps)) <= 0.02 * int(dense.stats.n_steps)
    np.testing.assert_allclose(structured.ys, dense.ys, rtol=1e-5, atol=1e-8)


def dense_jacobian(scene):
    structure, _ = flatten_system(compile_scene(scene).system)
    rate = program_for(state_rate, structure)

    def jacobian(t, y, args):
        return jax.jacfwd(lambda y: rate(args.theta, t, y))(y), jnp.zeros_like(y)

    return jacobian


def test_derivatives_pass_through_the_structured_solve():
    """By the numbers and by the state, against differences, with the rule that never enters the elimination."""
    scene = four_bar(MODELS["bushing"])  # linear in the deflection, so that differences may be wide
    structure, theta = flatten_system(compile_scene(scene).system)
    jacobian, factorize = hooks_of(structure)
    y = sj.simulate(scene, jnp.array([0.0, 0.02]), rtol=1e-6).ys[-1]
    rng = np.random.default_rng(2)
    theta, rhs = jnp.asarray(theta), jnp.asarray(rng.normal(size=y.shape))
    # Numbers that are structural zeros are no numbers: the others move in proportion.
    theta_dot, y_dot = 1e-2 * theta * rng.normal(size=theta.shape), 1e-2 * jnp.asarray(rng.normal(size=y.shape))

    @jax.jit
    def solution(s):
        at, _ = jacobian(jnp.zeros(()), y + s * y_dot, Parameters(theta + s * theta_dot, ()))
        return factorize(at, GAMMA_H * (1 + s))[0](rhs * (1 + 2 * s))

    _, tangent = jax.jvp(solution, (0.0,), (1.0,))
    h = 1e-3
    differences = (8 * (solution(h) - solution(-h)) - (solution(2 * h) - solution(-2 * h))) / (12 * h)
    np.testing.assert_allclose(tangent, differences, rtol=1e-6, atol=1e-7 * float(jnp.max(jnp.abs(differences))))


def test_only_rosenbrock_methods_without_a_jacobian_get_the_structure():
    import diffrax

    structure, _ = flatten_system(compile_scene(sj.gallery.four_bar(sj.Ideal())).system)
    explicit, own = diffrax.Dopri8(), sj.Rodas5P(jacobian=lambda t, y, args: (jnp.eye(2), jnp.zeros(2)))
    assert with_structure(explicit, structure) is explicit
    assert with_structure(own, structure) is own
    assert with_structure(sj.Rodas4P(), structure).jacobian is not None
