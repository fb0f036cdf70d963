"""Derivatives of runs by more numbers than rows of sensitivities are for.

Closed forms of an oscillator that forty sines drive, along one direction and back along the steps; through contact,
gradients against derivatives along directions, which are integrated beside the run, with their errors controlled.
"""

import logging
from collections.abc import Callable

import controlling
import diffrax
import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.derivatives import pullback, sensitivities
from spherejax.motion.derivatives.sensitivities import MANY
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.start import assembly

N = MANY + 8
FREQUENCIES = jnp.arange(1, N + 1) / 7.0
STIFFNESS, MASS = 9.0, 0.7
TS = jnp.linspace(0.0, 2.0, 9)
STRENGTHS = jnp.asarray(np.random.default_rng(3).normal(size=N))


def sines(strengths, t):
    return jnp.sum(strengths * jnp.sin(FREQUENCIES * t)) / N


def driven(strengths) -> sj.Scene:
    """m x'' = -k x + sum of a_i sin(w_i t) / n, at rest at the start."""

    def force(t, motions):
        x = motions["ball"].position[0]
        return jnp.stack([sines(strengths, t) - STIFFNESS * x, 0 * x, 0 * x])

    return sj.Scene(
        {"ball": sj.Body(MASS, (1e-3,) * 3)}, forces={"drive": sj.AppliedWrench("ball", force)}, gravity=(0.0, 0.0, 0.0)
    )


def places(strengths, **options):
    return sj.simulate(driven(strengths), TS, rtol=1e-9, **options).position("ball")[:, 0]


def exact_slopes():
    """dx/da_i = (sin(w_i t) - w_i / w0 sin(w0 t)) / (m n (w0^2 - w_i^2)), shape (samples, n)."""
    own, w, t = np.sqrt(STIFFNESS / MASS), np.asarray(FREQUENCIES), np.asarray(TS)[:, None]
    return (np.sin(w * t) - w / own * np.sin(own * t)) / (MASS * N * (own**2 - w**2))


WEIGHTS = jnp.asarray([0.0, 1.0, 0.0, -2.0, 0.5, 0.0, 0.0, 3.0, 1.5])


def wanted(strengths, **options):
    return WEIGHTS @ places(strengths, **options)


@pytest.mark.parametrize("way", [pytest.param("now", marks=pytest.mark.slow), "jit"])
def test_a_gradient_by_many_numbers(way):
    gradient = jax.grad(wanted) if way == "now" else jax.jit(jax.grad(wanted))
    np.testing.assert_allclose(gradient(STRENGTHS), np.asarray(WEIGHTS) @ exact_slopes(), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize(
    "solver",
    [
        sj.solvers.Rodas5P(),
        pytest.param(sj.solvers.Ros34PW2(), marks=pytest.mark.slow),
        pytest.param(diffrax.Kvaerno5(), marks=pytest.mark.slow),
    ],
    ids=["Rodas5P", "W", "implicit"],
)
def test_a_gradient_by_a_stiff_method(solver):
    """Rosenbrock steps are gone back with their matrix differentiated; an implicit method gets those of Rodas5P."""
    gradient = jax.jit(jax.grad(lambda strengths: wanted(strengths, solver=solver)))(STRENGTHS)
    exact = np.asarray(WEIGHTS) @ exact_slopes()
    np.testing.assert_allclose(gradient, exact, atol=1e-5 * np.abs(exact).max())


@pytest.mark.slow
def test_a_film_by_all_numbers_of_its_bodies(monkeypatch):
    """Rows for each number beside the way back along the same steps."""
    scene = sj.gallery.four_bar(sj.Lubricated(clearance=1e-4, viscosity=0.4))

    def masses_of(scene):
        return [leaf for body in scene.bodies.values() for leaf in (body.mass, body.inertia)]

    flat, unflatten = jax.flatten_util.ravel_pytree([jnp.asarray(leaf, jnp.float64) for leaf in masses_of(scene)])

    def speed(factors):
        moved = eqx.tree_at(masses_of, scene, unflatten(factors * flat))
        return jnp.sum(sj.simulate(moved, jnp.linspace(0.0, 0.02, 5)).velocity("rocker") ** 2)

    found = []
    for many in (4, 1000):
        monkeypatch.setattr(sensitivities, "MANY", many)
        found.append(jax.grad(speed)(jnp.ones_like(flat)))
    np.testing.assert_allclose(*found, atol=1e-9 * np.abs(found[1]).max())


def test_a_derivative_along_one_direction():
    direction = jnp.asarray(np.random.default_rng(4).normal(size=N))
    for size in (1.0, 1e9, 0.0):
        _, slope = jax.jvp(places, (STRENGTHS,), (size * direction,))
        np.testing.assert_allclose(slope, exact_slopes() @ (size * direction), rtol=1e-6, atol=1e-9 * size)


@pytest.mark.slow
def test_a_jacobian_in_both_modes():
    for jacobian in (jax.jacfwd(places)(STRENGTHS), jax.jacrev(places)(STRENGTHS)):
        np.testing.assert_allclose(jacobian, exact_slopes(), rtol=1e-6, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("order", ["vmap of grad", "grad of vmap", "jvp of vmap"])
def test_many_runs(order):
    several = jnp.stack([STRENGTHS, -0.3 * STRENGTHS, 0.0 * STRENGTHS])
    exact = np.asarray(WEIGHTS) @ exact_slopes()
    if order == "vmap of grad":
        slopes = jax.vmap(jax.grad(wanted))(several)
    elif order == "grad of vmap":
        slopes = jax.grad(lambda rows: jnp.sum(jax.vmap(wanted)(rows)))(several)
    else:
        along = jnp.ones_like(several)
        slope = jax.jvp(jax.vmap(wanted), (several,), (along,))[1]
        np.testing.assert_allclose(slope, np.full(3, exact.sum()), rtol=1e-6)
        return
    np.testing.assert_allclose(slopes, np.broadcast_to(exact, several.shape), rtol=1e-6, atol=1e-10)


def test_gradients_of_mapped_runs_are_made_by_one_call_on_all_processors():
    several = jnp.stack([STRENGTHS, -0.3 * STRENGTHS])
    many, alone = jax.jit(jax.vmap(jax.grad(wanted))), jax.jit(jax.grad(wanted))
    assert "spherejaxruns_" in many.lower(several).as_text()
    np.testing.assert_allclose(many(several), [alone(one) for one in several], rtol=1e-9)


def test_in_reverse_mode_a_run_is_made_once_and_keeps_its_steps():
    """Where one program holds both: the value is that of the run with the sensitivity that the way back needs."""
    value, gradient = jax.jit(jax.value_and_grad(wanted))(STRENGTHS)
    assert float(value) == pytest.approx(float(np.asarray(WEIGHTS) @ exact_slopes() @ np.asarray(STRENGTHS)), rel=1e-7)
    np.testing.assert_allclose(gradient, np.asarray(WEIGHTS) @ exact_slopes(), rtol=1e-7, atol=1e-10)

    def operations(function):
        return str(jax.make_jaxpr(function)(STRENGTHS))

    assert "run_that_keeps_steps" in operations(jax.grad(wanted))
    # Forward there is no way back, and side by side steps of all runs would take room that most of them do not need.
    for other in (
        lambda strengths: jax.jvp(wanted, (strengths,), (strengths,)),
        lambda strengths: jax.vmap(jax.grad(wanted))(strengths[None]),
        lambda strengths: jax.grad(lambda strengths: wanted(strengths, solver=diffrax.Kvaerno5()))(strengths),
    ):
        assert "run_that_keeps_steps" not in operations(other)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["room", "max_steps", "vmap", "jvp"])
def test_a_run_that_keeps_no_steps_has_the_same_value_and_gradient(way, monkeypatch):
    exact = np.asarray(WEIGHTS) @ exact_slopes()

    def both(strengths, **options):
        return jax.jit(jax.value_and_grad(lambda strengths: wanted(strengths, **options)))(strengths)

    expected = float(exact @ np.asarray(STRENGTHS))
    if way == "room":  # a fifth of the steps
        n_steps = int(sj.simulate(driven(STRENGTHS), TS, rtol=1e-9).stats.n_accepted)
        monkeypatch.setattr(pullback, "ROOM", n_steps // 5)
        for function in (pullback.pulled_back, pullback.run_that_keeps_steps):
            function.clear()
        value, gradient = both(STRENGTHS)
        for function in (pullback.pulled_back, pullback.run_that_keeps_steps):
            function.clear()
    elif way == "max_steps":
        value, gradient = both(STRENGTHS, max_steps=3)
        assert np.isnan(value)
        assert np.isnan(gradient).all()
        return
    elif way == "vmap":
        values, gradients = jax.vmap(both)(jnp.stack([STRENGTHS, 2 * STRENGTHS]))
        np.testing.assert_allclose(values, [expected, 2 * expected], rtol=1e-7)
        np.testing.assert_allclose(gradients, [exact, exact], rtol=1e-6, atol=1e-10)
        return
    else:  # of what is linear in the strengths
        (value, gradient), (slope, none) = jax.jvp(both, (STRENGTHS,), (jnp.ones(N),))
        assert float(slope) == pytest.approx(exact.sum(), rel=1e-6)
        np.testing.assert_allclose(none, 0.0, atol=1e-6)
    assert float(value) == pytest.approx(expected, rel=1e-7)
    np.testing.assert_allclose(gradient, exact, rtol=1e-6, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e4, 1e9])
def test_a_method_that_is_chosen_when_the_run_starts(stiffness):
    """With 1e4 N/m it is the explicit one, whose run keeps its steps; with 1e9 the stiff one, whose run keeps none."""
    scene = sj.gallery.four_bar(sj.Bushing(stiffness, 1e-3))
    numbers, rest = eqx.partition(scene, lambda leaf: isinstance(leaf, float) or eqx.is_inexact_array(leaf))
    flat, unflatten = jax.flatten_util.ravel_pytree(jax.tree.map(jnp.asarray, numbers))

    def height(flat):
        whole = eqx.combine(unflatten(flat), rest)
        return sj.simulate(whole, jnp.linspace(0.0, 0.02, 4), rtol=1e-8).position("rocker")[-1, 2]

    value, gradient = jax.jit(jax.value_and_grad(height))(flat)
    assert float(value) == pytest.approx(float(jax.jit(height)(flat)), rel=1e-6)
    along = jnp.asarray(np.random.default_rng(5).normal(size=flat.size)) * flat
    slope = jax.jit(lambda flat: jax.jvp(height, (flat,), (along,))[1])(flat)
    assert float(gradient @ along) == pytest.approx(float(slope), rel=1e-4)


@pytest.mark.slow
def test_second_derivatives_go_by_rows():
    """x is linear in the strengths; a square of it is not."""

    def square(strengths):
        return places(strengths)[-1] ** 2

    last = exact_slopes()[-1]
    along = jax.jvp(jax.grad(square), (STRENGTHS,), (jnp.ones(N),))[1]
    np.testing.assert_allclose(along, 2 * last * last.sum(), rtol=1e-5, atol=1e-10)


def test_a_run_that_fails_has_no_gradient():
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        gradient = jax.grad(lambda strengths: wanted(strengths, max_steps=3))(STRENGTHS)
    assert np.isnan(gradient).all()


def bouncing(strengths) -> sj.Scene:
    """A ball in a socket, thrown at its wall and driven there by forty sines."""

    def force(t, motions):
        x = motions["ball"].position[0]
        return jnp.stack([0.1 * sines(strengths, t), 0.05 * sines(strengths[::-1], t), 0 * x])

    joint = sj.Spherical("ground.socket", "ball.center", sj.Dry(1e-3, friction=sj.Threlfall()), starts_concentric=False)
    ball = sj.Body(0.1, (1e-4,) * 3, velocity=(0.2, 0.05, 0.0), points={"center": (0.0, 0.0, 0.0)})
    drive = sj.AppliedWrench("ball", force)
    return sj.Scene({"ball": ball}, {"joint": joint}, {"drive": drive}, ground_points={"socket": (0.0, 0.0, 0.0)})


def end_of_bounces(strengths):
    run = sj.simulate(bouncing(strengths), jnp.linspace(0.0, 0.05, 4), rtol=1e-9)
    return 1e3 * jnp.sum(run.position("ball")[:, 0]) + run.velocity("ball")[-1, 1]


@pytest.mark.slow
def test_through_contact_the_gradient_is_the_derivative_along_every_direction():
    run = sj.simulate(bouncing(STRENGTHS), jnp.array([0.0, 0.05]))
    assert int(run.stats.n_onsets[0]) >= 3
    gradient = jax.grad(end_of_bounces)(STRENGTHS)
    assert np.abs(gradient).max() > 5e-5
    for seed in range(3):
        direction = jnp.asarray(np.random.default_rng(seed).normal(size=N))
        slope = jax.jvp(end_of_bounces, (STRENGTHS,), (direction,))[1]
        assert float(gradient @ direction) == pytest.approx(float(slope), abs=1e-5 * float(jnp.linalg.norm(gradient)))


@pytest.mark.slow
def test_numbers_that_hardly_move_the_ball_have_a_gradient_of_as_many_digits(monkeypatch):
    """A sine moves the ball by a millionth of its speed: judged in the state's tolerances 1.3e-5 was left."""

    def end(strengths, rtol):
        run = sj.simulate(bouncing(strengths), jnp.linspace(0.0, 0.05, 4), rtol=rtol)
        return 1e3 * jnp.sum(run.position("ball")[:, 0]) + run.velocity("ball")[-1, 1]

    back = jax.jit(jax.grad(lambda strengths: end(strengths, 1e-8)))(STRENGTHS)
    monkeypatch.setattr(sensitivities, "MANY", 1000)
    rows = jax.jit(jax.grad(lambda strengths: end(strengths, 1e-11)))(STRENGTHS)
    np.testing.assert_allclose(back, rows, atol=2e-6 * np.abs(rows).max())


@pytest.mark.slow
@pytest.mark.parametrize("model", [sj.Dry(1e-4, friction=sj.Threlfall()), sj.Lubricated(1e-4, viscosity=0.4)])
def test_the_steps_back_are_machine_code_as_a_whole(model, caplog):
    """Else XLA calls some hundred kernels for each step back, and the gradient takes half as long again.

    The exponent of the contact is one of the numbers: its stiffness may be there at once. With that the run was made by
    array code, and the gradient took five times as long.
    """
    scene = sj.gallery.four_bar(model)
    exponent = lambda scene: scene.joints["coupler_rocker"].model.normal.exponent  # noqa: E731
    numbers, rest = eqx.partition(scene, lambda leaf: isinstance(leaf, float) or eqx.is_inexact_array(leaf))

    def height(numbers):
        whole = eqx.combine(numbers, rest)
        if isinstance(model, sj.Lubricated):  # by Rosenbrock methods no derivative is sure by a traced exponent
            whole = eqx.tree_at(exponent, whole, exponent(scene))
        return sj.simulate(whole, jnp.array([0.0, 0.01])).position("rocker")[-1, 2]

    pullback.pulled_back.clear()
    with caplog.at_level(logging.INFO, logger="spherejax.compiler"):
        text = jax.jit(jax.grad(height)).lower(jax.tree.map(jnp.asarray, numbers)).as_text()
    assert "spherejaxprogram_" in text
    assert "left to XLA" not in caplog.text


@pytest.mark.slow
def test_a_run_with_more_steps_than_there_is_room_for_is_cut(monkeypatch):
    whole = jax.grad(end_of_bounces)(STRENGTHS)
    monkeypatch.setattr(pullback, "ROOM_WITH_CONTACT", 32)  # of some 500 steps
    pullback.pulled_back.clear()
    cut = jax.grad(end_of_bounces)(STRENGTHS)
    pullback.pulled_back.clear()
    # Each stretch finds a first step of its own.
    np.testing.assert_allclose(cut, whole, atol=1e-5 * np.abs(whole).max())


def four_bar_by_numbers() -> tuple[Callable, jax.Array]:
    """The height of the rocker of a dry four-bar at the end, as a function of all numbers of its scene."""
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall()))
    numbers, rest = eqx.partition(scene, lambda leaf: isinstance(leaf, float) or eqx.is_inexact_array(leaf))
    flat, unflatten = jax.flatten_util.ravel_pytree(jax.tree.map(jnp.asarray, numbers))

    def height(flat, rtol=1e-9):
        whole = eqx.combine(unflatten(flat), rest)
        return sj.simulate(whole, jnp.array([0.0, 0.1]), rtol=rtol).position("rocker")[-1, 2]

    return height, flat


def test_a_traced_exponent_needs_no_rows():
    """It may be one whose stiffness is there at once; the way back goes through such contacts as well."""
    height, flat = four_bar_by_numbers()
    operations = str(jax.make_jaxpr(jax.grad(height))(flat))
    assert "linear_operation" in operations


@pytest.mark.slow
@pytest.mark.parametrize(("exponent", "stiffness"), [(1.0, 1e5), (1.05, 1e5), (1.2, 1e6), (1.4, 1e7), (2.0, 1e10)])
def test_through_contacts_of_any_exponent(exponent, stiffness):
    """By the exponent too, against derivatives along single directions, whose errors are controlled by themselves."""

    def end(numbers):
        scene = bouncing(numbers[3:])
        normal = sj.LankaraniNikravesh(restitution=numbers[2], stiffness=stiffness * numbers[0], exponent=numbers[1])
        scene = eqx.tree_at(lambda scene: scene.joints["joint"].model.normal, scene, normal)
        run = sj.simulate(scene, jnp.linspace(0.0, 0.05, 4))
        return 1e3 * jnp.sum(run.position("ball")[:, 0]) + run.velocity("ball")[-1, 1], run.stats.n_onsets

    at = jnp.concatenate([jnp.array([1.0, exponent, 0.8]), STRENGTHS])
    gradient, n_onsets = jax.jit(jax.grad(end, has_aux=True))(at)
    assert int(n_onsets[0]) >= 3
    beside = jax.jit(lambda along: jax.jvp(lambda at: end(at)[0], (at,), (along,))[1])
    mixed = jnp.asarray(np.random.default_rng(5).normal(size=at.size))
    for along in (*jnp.eye(at.size)[:3], mixed):
        size = float(jnp.linalg.norm(gradient) * jnp.linalg.norm(along))
        # The largest is 5e-7, by an exponent of 1.4; with `derivative_rtol=2e-8` it is 3e-8.
        assert float(gradient @ along) == pytest.approx(float(beside(along)), abs=1e-6 * size)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["now", "jit", "vmap"])
def test_by_all_numbers_of_a_mechanism_with_contact(way, monkeypatch):
    """The exponent of the contact is one of them. Rows, whose errors are controlled one by one, are the reference."""
    height, flat = four_bar_by_numbers()
    assert flat.size > MANY
    if way == "vmap":
        back = jax.jit(jax.vmap(jax.grad(height)))(jnp.stack([flat, flat]))
        np.testing.assert_array_equal(*back)
        back = back[0]
    else:
        back = (jax.jit if way == "jit" else lambda function: function)(jax.grad(height))(flat)
    monkeypatch.setattr(sensitivities, "MANY", 1000)
    rows = jax.jit(jax.grad(lambda flat: height(flat)))(flat)
    np.testing.assert_allclose(back, rows, atol=1e-6 * float(jnp.max(jnp.abs(rows))))


@pytest.mark.slow
def test_by_all_numbers_of_a_mechanism_with_contact_against_differences():
    height, flat = four_bar_by_numbers()
    along = jnp.asarray(np.random.default_rng(2).normal(size=flat.size)) * jnp.where(flat == 0, 0.0, flat)
    h = 1e-6
    value = jax.jit(lambda flat: height(flat, 1e-12))
    difference = float(value(flat + h * along) - value(flat - h * along)) / (2 * h)
    assert float(jax.jit(jax.grad(height))(flat) @ along) == pytest.approx(difference, rel=1e-5)


@pytest.mark.slow
def test_by_the_weights_of_a_network_that_is_built_within_the_transformation():
    module = eqx.nn.MLP(2, "scalar", 8, 2, activation=jnp.tanh, key=jax.random.key(1))

    def wanted(module, rtol=1e-9):
        scene = sj.Scene(
            {"ball": sj.Body(1.0, (1, 1, 1), position=(0.5, 0, 0))},
            forces={"law": controlling.NeuralForce(sj.Network(module))},
            gravity=(0, 0, 0),
        )
        return jnp.mean(sj.simulate(scene, TS, rtol=rtol).position("ball")[:, 0] ** 2)

    gradient = eqx.filter_jit(eqx.filter_grad(wanted))(module)
    weights, rest = eqx.partition(module, eqx.is_inexact_array)
    flat, unflatten = jax.flatten_util.ravel_pytree(weights)
    assert flat.size > MANY
    along = jnp.asarray(np.random.default_rng(0).normal(size=flat.size))
    slope = jax.flatten_util.ravel_pytree(gradient)[0] @ along
    beside = jax.jvp(lambda flat: wanted(eqx.combine(unflatten(flat), rest)), (flat,), (along,))[1]
    assert float(slope) == pytest.approx(float(beside), rel=1e-4)
    # The third derivative is large: with steps of 1e-4 differences have four digits, if the values have twelve.
    ahead, back = (wanted(eqx.combine(unflatten(flat + h * along), rest), 1e-12) for h in (1e-4, -1e-4))
    assert float(slope) == pytest.approx(float(ahead - back) / 2e-4, rel=1e-4)


@pytest.mark.slow
def test_a_start_that_is_assembled_by_array_code_has_its_derivatives(monkeypatch):
    """Of chains of 7 bodies and more; these bodies are moved by the assembly, so that masses and places matter."""
    monkeypatch.setattr(assembly, "LARGEST_OF_START", 100)
    monkeypatch.setattr(sensitivities, "MANY", 4)
    scene, ts = sj.gallery.chain(3), jnp.linspace(0.0, 0.2, 3)
    ideal, _ = flatten_system(assembly.as_ideal(compile_scene(scene).system))
    assert assembly.is_assembled_by_arrays(ideal)
    names = list(scene.bodies)
    given = jnp.concatenate([jnp.ravel(jnp.asarray(scene.bodies[name].position)) for name in names])

    def end(numbers):
        masses, places = numbers[:3], numbers[3:].reshape(3, 3)
        moved = eqx.tree_at(lambda scene: [scene.bodies[name].mass for name in names], scene, list(masses))
        moved = eqx.tree_at(lambda scene: [scene.bodies[name].position for name in names], moved, list(places))
        return sj.simulate(moved, ts).position(names[-1])[-1, 0]

    numbers = jnp.concatenate([jnp.array([0.5, 0.7, 0.9]), given + 1e-3 * jnp.cos(jnp.arange(9.0))])
    back = jax.grad(end)(numbers)
    monkeypatch.setattr(sensitivities, "MANY", 100)
    rows = jax.grad(end)(numbers)
    np.testing.assert_allclose(back, rows, atol=1e-6 * np.abs(rows).max())
    assert (np.abs(rows) > 1e-6).sum() > 4


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::spherejax.errors.ArrayPathWarning")
def test_a_law_with_a_loop_that_has_no_reverse_mode_is_differentiated_by_rows():
    """Its gradient by up to 32 numbers was right, that by more ended in JAX's error about `while_loop`."""

    def root(value):
        """Its square root, by Newton's method."""
        goes_on, turn = lambda x: jnp.abs(x * x - value) > 1e-13, lambda x: 0.5 * (x + value / x)
        return jax.lax.while_loop(goes_on, turn, 1.0 + 0 * value)

    def end(numbers):
        def force(t, motions):
            pull = root(jnp.sum(numbers)) * motions["ball"].position[0]
            return jnp.stack([-pull, 0 * pull, 0 * pull])

        ball = sj.Body(1.0, (1, 1, 1), position=(0.5, 0, 0))
        scene = sj.Scene({"ball": ball}, forces={"law": sj.AppliedWrench("ball", force)}, gravity=(0, 0, 0))
        return sj.simulate(scene, jnp.array([0.0, 0.3]), rtol=1e-10).position("ball")[-1, 0]

    # x = cos(w t) / 2 with w^4 the sum of the numbers.
    w = 2.0
    slope = -0.5 * 0.3 * np.sin(0.3 * w) / (4 * w**3)
    gradient = jax.jit(jax.grad(end))(jnp.full(MANY + 4, w**4 / (MANY + 4)))
    np.testing.assert_allclose(gradient, slope, rtol=1e-6)


@pytest.mark.slow
def test_a_gradient_of_many_bodies_is_made_of_rows():
    """XLA ends the process where it compiles the way back of array code with joints."""
    scene, ts = sj.gallery.chain(42), jnp.linspace(0.0, 0.2, 3)
    names = list(scene.bodies)[:36]

    def end(masses):
        heavier = eqx.tree_at(lambda scene: [scene.bodies[name].mass for name in names], scene, list(masses))
        return sj.simulate(heavier, ts).position(list(scene.bodies)[-1])[-1, 0]

    masses = jnp.array([float(scene.bodies[name].mass) for name in names])
    gradient = jax.grad(end)(masses)
    step = 1e-3 * masses[1] * jnp.eye(len(names))[1]
    difference = (end(masses + step) - end(masses - step)) / (2 * step[1])
    assert float(gradient[1]) == pytest.approx(float(difference), abs=1e-6 * float(jnp.max(jnp.abs(gradient))))
    assert jnp.all(jnp.isfinite(gradient))
    assert jnp.max(jnp.abs(gradient)) > 1e-3


@pytest.mark.slow
def test_a_gradient_through_array_code_is_that_through_a_scalar_program():
    scene, ts = sj.gallery.four_bar(), jnp.linspace(0.0, 0.05, 3)
    numbers, rest = eqx.partition(scene, eqx.is_inexact_array)
    flat, unflatten = jax.flatten_util.ravel_pytree(numbers)
    assert flat.size > MANY

    def end(flat, scalar):
        return sj.simulate(eqx.combine(unflatten(flat), rest), ts, scalar=scalar).position("rocker")[-1, 2]

    by_arrays, by_numbers = (jax.grad(end)(flat, scalar) for scalar in (False, True))
    np.testing.assert_allclose(by_arrays, by_numbers, rtol=0, atol=1e-7 * float(jnp.max(jnp.abs(by_numbers))))


@pytest.mark.slow
def test_a_study_in_reverse_through_array_code_is_one_forward():
    """It asks for the way back itself, whose place rows take."""

    def chain(first, middle):
        scene = sj.gallery.chain(42)
        masses = [scene.bodies[name].mass * by for name, by in (("link_01", first), ("link_21", middle))]
        return eqx.tree_at(lambda scene: [scene.bodies[name].mass for name in ("link_01", "link_21")], scene, masses)

    def last(run):
        return run.position("link_42")[-1, 0]

    at, ts = {"first": 1.0, "middle": 1.3}, jnp.linspace(0.0, 0.2, 3)
    back, ahead = (
        np.ravel(sj.sensitivity(chain, at, ts, of=last, mode=mode).columns[0].slopes) for mode in ("reverse", "forward")
    )
    np.testing.assert_allclose(back, ahead, rtol=1e-6)
    assert np.abs(ahead).min() > 1e-6


def stiff_height(scene, rtol):
    """Height of the rocker after 0.1 s [m], with a bushing whose damping time, 100 s, makes rates of 7e8 per second."""
    return sj.simulate(scene, ts=jnp.array([0.0, 0.1]), rtol=rtol).position("rocker")[-1, 2]


@pytest.mark.slow
def test_a_gradient_with_too_large_an_error_amplification_is_nan_and_warns():
    """Without the check it is wrong by a tenth at an rtol of 1e-7, and by eleven orders of magnitude at 1e-6."""
    scene = sj.gallery.four_bar(sj.Bushing(1e6, 100.0))
    gradient = eqx.filter_grad(stiff_height)
    for rtol in (1e-6, 1e-7):
        with pytest.warns(sj.errors.SimulationWarning, match="too sensitive for its tolerances"):
            wrong = gradient(scene, rtol)
        assert all(np.all(np.isnan(leaf)) for leaf in jax.tree.leaves((wrong.gravity, wrong.bodies["coupler"])))
    right, finer = (gradient(scene, rtol).bodies["coupler"].velocity for rtol in (1e-8, 1e-9))
    np.testing.assert_allclose(right, finer, rtol=1e-5)


@pytest.mark.slow
def test_a_derivative_that_moves_numbers_which_are_zero_but_for_rounding():
    """Scaled by these numbers its errors vanished in the absolute tolerance: it was 6e4 in place of 9e-6."""
    numbers, others = eqx.partition(sj.gallery.four_bar(sj.Bushing(1e6, 100.0)), eqx.is_inexact_array)
    shares = np.random.default_rng(0)
    along = jax.tree.map(lambda leaf: 1e-3 * shares.normal(size=leaf.shape) * jnp.abs(leaf), numbers)
    loose, tight = (
        jax.jvp(lambda numbers, rtol=rtol: stiff_height(eqx.combine(numbers, others), rtol), (numbers,), (along,))[1]
        for rtol in (1e-6, 1e-9)
    )
    assert abs(loose - tight) < 1e-4 * abs(tight)


def test_numbers_of_an_array_are_as_large_as_the_largest_of_them():
    """One that is zero but for rounding too; and all of those of which none is larger than that."""
    values = np.array([0.3, -1e-17, 2e-5, 0.0, 1e-17, 0.0, 0.0, 1e-17])
    arrays = np.array([0, 0, 1, 2, 3, 3, 4, 5])
    expected = [0.3, 0.3, 2e-5, 1.0, 1e-6, 1e-6, 1.0, 1e-9]
    np.testing.assert_array_equal(scales_of(values, arrays), expected)
    np.testing.assert_array_equal(jax.jit(lambda values: scales_of(values, arrays))(values), expected)


@pytest.mark.slow
def test_unrolled_stages_have_the_gradient_of_the_loop(monkeypatch):
    height, at = four_bar_by_numbers()
    unrolled = jax.grad(height)(at)
    monkeypatch.setattr(pullback, "LARGEST_UNROLLED", 0)
    pullback.pulled_back.clear()
    np.testing.assert_allclose(jax.grad(height)(at), unrolled, atol=1e-9 * np.abs(unrolled).max())
    pullback.pulled_back.clear()
