"""jit, vmap, forward and reverse derivatives of whole runs agree with loops and with finite differences."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj


class Family(NamedTuple):
    """Scenes that depend on physical numbers, and how well their derivatives can be known.

    Attributes:
        build: from the numbers, in the order of `values`, to a scene.
        values: where the derivative is taken.
        t_end: horizon [s].
        rtol: tolerance of the runs.
        agreement: of derivatives with central differences, relative to the largest entry of the row.
        step: shortest of three relative steps of the differences.
        solver: of the runs; chosen automatically when None.
    """

    build: Callable
    values: dict[str, float]
    t_end: float
    rtol: float
    agreement: float
    step: float
    solver: diffrax.AbstractSolver | None = None


def four_bar(model=None, mass=None, inertia=None, length=None, gravity=None):
    """The four-bar with some of the mechanism's own numbers replaced."""
    scene = sj.gallery.four_bar(model)
    if mass is not None:
        scene = eqx.tree_at(lambda s: s.bodies["coupler"].mass, scene, mass)
    if inertia is not None:
        scene = eqx.tree_at(
            lambda s: s.bodies["rocker"].inertia, scene, inertia * jnp.array([1.456e-4, 2.9e-6, 1.456e-4])
        )
    if length is not None:
        scene = eqx.tree_at(lambda s: s.bodies["crank"].points["pin"], scene, length * jnp.array([0.0, 0.0, 1.0]))
    if gravity is not None:
        scene = eqx.tree_at(lambda s: s.gravity, scene, gravity * jnp.array([0.0, 0.0, -1.0]))
    return scene


def dry(c, radius, c_r, modulus, poisson):
    normal, steel = sj.LankaraniNikravesh(restitution=c_r), sj.Material(modulus, poisson)
    return four_bar(sj.Dry(clearance=c, socket_radius=radius, normal=normal, ball_material=steel))


def friction(c, mu, v1):
    return four_bar(sj.Dry(clearance=c, friction=sj.Threlfall(mu=mu, v1=v1)))


def lubricated(c, radius, viscosity, e_h0, e_h1):
    return four_bar(sj.Lubricated(clearance=c, socket_radius=radius, viscosity=viscosity, e_h0=e_h0, e_h1=e_h1))


FILM = {"c": 1e-4, "radius": 0.010, "viscosity": 0.4, "e_h0": 1e-6, "e_h1": 2e-6}
STEEL = {"modulus": 207e9, "poisson": 0.3}
# The agreement is that of the differences, which rounding and curvature spoil for numbers with little effect;
# `test_sensitivities.py` measures the derivatives of impacting motions against a better reference.
FAMILIES = {
    "ideal": Family(
        four_bar, {"mass": 0.1416, "inertia": 1.0, "length": 0.020, "gravity": 9.81}, 0.05, 1e-10, 1e-6, 1e-5
    ),
    "dry": Family(dry, {"c": 1e-4, "radius": 0.010, "c_r": 0.9, **STEEL}, 0.02, 1e-11, 3e-3, 1e-6),
    "friction": Family(friction, {"c": 1e-4, "mu": 0.1, "v1": 1e-3}, 0.02, 1e-11, 2e-4, 1e-6),
    "lubricated": Family(lubricated, FILM, 0.02, 1e-10, 4e-3, 1e-4, diffrax.Dopri8()),
    "lubricated, automatic": Family(lubricated, FILM, 0.02, 1e-10, 2e-3, 1e-4),
    "bushing": Family(
        lambda k, b: four_bar(sj.Bushing(stiffness=k, damping=b)), {"k": 1e6, "b": 1e-4}, 0.02, 1e-10, 3e-4, 1e-4
    ),
}


# Of the others the slow tests: "lubricated, automatic" takes a minute and a half to compile.
QUICK = ("bushing",)
NAMES = [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in FAMILIES]


def outcome(family, x, **options):
    """Final positions and velocities [m, m/s] at values * (1 + x): derivatives by x are comparable."""
    numbers = {name: value * (1 + x[i]) for i, (name, value) in enumerate(family.values.items())}
    scene = family.build(**numbers) if family.build is four_bar else family.build(*numbers.values())
    options = {"solver": family.solver, "rtol": family.rtol, "atol": family.rtol / 1000, **options}
    run = sj.simulate(scene, cases.times(family.t_end), **options)
    return jnp.concatenate([run.position("rocker")[-1], run.velocity("rocker")[-1]])


@cache
def compiled(name):
    return jax.jit(lambda x: outcome(FAMILIES[name], x))


WEIGHTS = jnp.array([1.0, -2.0, 3.0, 0.1, -0.2, 0.3])


@cache
def derivatives(name):
    """At x = 0, the Jacobian in forward mode and the gradient of the weighted outcome in reverse mode.

    Both from one program, which takes half as long to compile as two.
    """
    zero = jnp.zeros(len(FAMILIES[name].values))

    @jax.jit
    def both(x):
        _, push = jax.linearize(lambda x: outcome(FAMILIES[name], x), x)
        (gradient,) = jax.linear_transpose(push, x)(WEIGHTS)
        return jax.vmap(push, out_axes=1)(jnp.eye(x.size)), gradient

    return jax.tree.map(np.asarray, both(zero))


@pytest.mark.parametrize("name", NAMES)
def test_jit_equals_eager(name):
    family = FAMILIES[name]
    zero = np.zeros(len(family.values))
    # The tolerance allows for one machine program that folds known numbers, and one that does not.
    scale = np.array([0.1] * 3 + [1.0] * 3)
    assert np.abs((compiled(name)(zero) - outcome(family, zero)) / scale).max() < 100 * family.rtol


@pytest.mark.parametrize("name", NAMES)
def test_vmap_equals_loop(name):
    family = FAMILIES[name]
    lanes = 1e-2 * np.random.default_rng(0).standard_normal((3, len(family.values)))
    batched = jax.jit(jax.vmap(lambda x: outcome(family, x)))(lanes)
    looped = np.stack([compiled(name)(lane) for lane in lanes])
    assert np.ptp(looped, axis=0).max() > 1e-9  # the lanes differ
    scale = np.array([0.1] * 3 + [1.0] * 3)
    assert np.abs((np.asarray(batched) - looped) / scale).max() < 100 * family.rtol


@pytest.mark.parametrize("name", NAMES)
def test_forward_derivative_meets_finite_differences(name):
    family = FAMILIES[name]
    jacobian, _ = derivatives(name)
    errors = []
    # Rounding spoils short steps and curvature long ones, for each parameter at its own length: the better one counts.
    for h in family.step * 10.0 ** np.arange(5):
        differences = np.stack(
            [(compiled(name)(e) - compiled(name)(-e)) / (2 * h) for e in h * np.eye(len(family.values))], 1
        )
        # By parameter, against its largest effect; positions and velocities have their own scales.
        # Positions by parameter, against its own effect; velocities, which feel the film's switch, against the largest.
        errors.append([_relative(jacobian[:3], differences[:3]), _relative(jacobian[3:], differences[3:], pooled=True)])
    error = np.nanmin(errors, axis=0).max(0)  # the longest steps leave the range of the numbers
    assert (error < family.agreement).all(), dict(zip(family.values, error, strict=True))


def _relative(found, expected, pooled=False):
    """Largest difference by column, relative to the column or, pooled, to the largest column.

    0 for a number without effect: the film is never pressed into contact here, so its transition width does nothing.
    """
    scale = np.abs(expected).max(0)
    scale = np.full_like(scale, scale.max()) if pooled else np.where(scale > 0, scale, 1.0)
    return np.abs(found - expected).max(0) / scale


@pytest.mark.parametrize("name", NAMES)
def test_reverse_derivative_equals_forward(name):
    jacobian, gradient = derivatives(name)
    expected = WEIGHTS @ jacobian
    assert gradient == pytest.approx(np.asarray(expected), abs=1e-9 * np.abs(expected).max())


def _pushed(x, **options):
    """A free body under a constant force: cheap to compile."""
    body = sj.Body(1.0 + x[0], (1e-3, 2e-3, 3e-3), angular_velocity=(1.0, 2.0, 3.0))
    force = sj.AppliedWrench("body", force=jnp.array([1.0, 0.0, 0.0]) * (1 + x[1]), place=(0.0, 0.1, 0.0))
    run = sj.simulate(sj.Scene({"body": body}, {}, {"push": force}), cases.times(0.1), **options)
    return run.position("body")[-1, 0] + run.angular_velocity("body")[-1, 2]


@pytest.mark.slow
def test_checkpointing_adjoint_agrees():
    zero = jnp.zeros(2)
    default = jax.jit(jax.grad(_pushed))(zero)
    options = {"adjoint": diffrax.RecursiveCheckpointAdjoint(), "max_steps": 256}
    checkpointed = jax.jit(jax.grad(lambda x: _pushed(x, **options)))(zero)
    assert np.asarray(checkpointed) == pytest.approx(np.asarray(default), rel=1e-7)
    tangents = [jax.jvp(lambda x: _pushed(x, adjoint=diffrax.ForwardMode()), (zero,), (e,))[1] for e in jnp.eye(2)]
    assert np.asarray(tangents) == pytest.approx(np.asarray(default), rel=1e-7)


def test_forward_adjoint_serves_reverse_mode_too():
    zero = jnp.zeros(2)
    gradient = jax.grad(lambda x: _pushed(x, adjoint=diffrax.ForwardMode()))(zero)
    assert np.asarray(gradient) == pytest.approx(np.asarray(jax.grad(_pushed)(zero)), rel=1e-12)


def test_derivative_that_the_adjoint_cannot_give_names_the_option():
    zero = jnp.zeros(2)
    with pytest.raises(TypeError, match=r"adjoint=RecursiveCheckpointAdjoint.*leave adjoint= out"):
        jax.jvp(lambda x: _pushed(x, adjoint=diffrax.RecursiveCheckpointAdjoint()), (zero,), (zero + 1,))
    with pytest.raises(NotImplementedError, match=r"adjoint=BacksolveAdjoint"):
        jax.grad(lambda x: _pushed(x, adjoint=diffrax.BacksolveAdjoint()))(zero)


@pytest.mark.slow
def test_second_derivative_of_a_smooth_motion():
    zero = jnp.zeros(2)
    hessian = jax.hessian(_pushed)(zero)
    slope = jax.jit(jax.grad(_pushed))
    h = 1e-4
    differences = np.stack([(slope(h * e) - slope(-h * e)) / (2 * h) for e in jnp.eye(2)])
    assert np.asarray(hessian) == pytest.approx(differences, abs=1e-5 * np.abs(differences).max())


def test_trajectory_passes_through_vmap_and_jit():
    runs = jax.jit(jax.vmap(lambda g: sj.simulate(four_bar(gravity=g), cases.times(0.05, 3), rtol=1e-10)))(
        jnp.array([9.81, 1.62])
    )
    assert runs.ys.shape == (2, 3, 39)
    assert np.asarray(runs.succeeded).all()
    accelerations = jax.vmap(lambda run: run.acceleration("rocker"))(runs)
    for lane, g in enumerate((9.81, 1.62)):
        alone = sj.simulate(four_bar(gravity=g), cases.times(0.05, 3), rtol=1e-10).acceleration("rocker")
        assert np.asarray(accelerations[lane]) == pytest.approx(np.asarray(alone), abs=1e-7 * g)
