"""The equations as functions: `sj.ode` against runs, against mechanics written out in NumPy, and in plain diffrax."""

from functools import cache

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from cases import FOUR_BAR_MODELS, MODELS
from controlling import sampled_answer, sampled_motor
from scipy.spatial.transform import Rotation

import spherejax as sj

MODELS_HERE = {**FOUR_BAR_MODELS, "friction in ideal joint": MODELS["ideal_threlfall"]}
FAST = ("bushing", "friction", "ideal")
EACH = [pytest.param(name, marks=[] if name in FAST else [pytest.mark.slow]) for name in sorted(MODELS_HERE)]


def four_bar(model, drift=None) -> sj.Scene:
    return sj.gallery.four_bar(model, drift=sj.solvers.NoDriftControl() if drift is None else drift)


@cache
def moving(name: str) -> tuple[sj.equations.Ode, sj.Trajectory]:
    """A four-bar and its run into the first contact (7.93 to 8.04 ms), where the accelerations are largest."""
    scene = four_bar(MODELS_HERE[name], sj.solvers.Baumgarte())
    return sj.ode(scene), sj.simulate(scene, jnp.array([0.0, 4e-3, 8e-3]))


def turned(rotation: Rotation, quaternion) -> np.ndarray:
    """A quaternion, scalar first, behind a rotation in world axes."""
    return (rotation * Rotation.from_quat(quaternion, scalar_first=True)).as_quat(scalar_first=True)


def moved(f: sj.equations.EquationsOfMotion, y, velocities, dt: float):
    """The flat state after all bodies have moved with constant velocities (6 for each) for a time [s]."""
    state = f.unpack(y)
    bodies = {}
    for name, step in zip(f.bodies, np.reshape(velocities, (-1, 6)) * dt, strict=True):
        body = state.bodies[name]
        quaternion = turned(Rotation.from_rotvec(step[3:]), np.asarray(body.quaternion))
        bodies[name] = body._replace(position=body.position + step[:3], quaternion=jnp.asarray(quaternion))
    return f.pack(state._replace(bodies=bodies))


# Against runs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EACH)
def test_f_is_the_rate_of_the_run(name):
    (f, y0, args), run = moving(name)
    assert float(jnp.max(jnp.abs(y0 - run.ys[0]))) < 1e-15
    rates = jax.vmap(f, (0, 0, None))(run.ts, run.ys, args)
    assert rates.shape == run.ys.shape
    named = f.unpack(rates).bodies
    largest = max(float(jnp.max(jnp.abs(run.acceleration(body)))) for body in f.bodies)
    assert largest > 0.1
    for body in f.bodies:
        assert float(jnp.max(jnp.abs(named[body].velocity - run.acceleration(body)))) < 1e-11 * largest
        assert float(jnp.max(jnp.abs(named[body].position - run.velocity(body)))) == 0.0


@pytest.mark.parametrize("name", EACH)
def test_energies_reactions_and_observables_are_those_of_the_run(name):
    (f, _, args), run = moving(name)
    t, y = run.ts[-1], run.ys[-1]
    energies = f.energies(t, y, args)
    assert float(energies.mechanical) == pytest.approx(float(run.mechanical_energy[-1]), rel=1e-13)
    assert float(energies.kinetic) == pytest.approx(float(run.kinetic_energy[-1]), rel=1e-13)
    reactions, seen = f.joint_reactions(t, y, args), f.observe(t, y, args)
    for joint, reaction in reactions.items():
        expected = np.asarray(run.reaction(joint)[-1])
        np.testing.assert_allclose(reaction.force, expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(reaction.force, seen.reactions[joint].force, rtol=1e-12)
    np.testing.assert_allclose(seen.eccentricity["coupler_rocker"], run.eccentricity("coupler_rocker")[-1], atol=1e-15)


def test_array_code_and_scalar_programs_are_the_same_equations():
    (f, y0, args), run = moving("friction")
    arrays = sj.ode(four_bar(MODELS_HERE["friction"], sj.solvers.Baumgarte()), scalar=False)
    assert arrays.f.scalar is False
    rate, other = f(0.0, run.ys[-1], args), arrays.f(0.0, run.ys[-1], arrays.args)
    np.testing.assert_allclose(rate, other, atol=1e-10 * float(jnp.max(jnp.abs(rate))))
    np.testing.assert_array_equal(arrays.y0, y0)


# Against mechanics written out ----------------------------------------------------------------------------------------


def test_mass_matrix_is_that_of_the_kinetic_energy():
    (f, _, args), run = moving("friction in ideal joint")
    y = run.ys[-1]
    matrix, state = np.asarray(f.mass_matrix(0.0, y, args)), f.unpack(y)
    energy = 0.0
    for i, name in enumerate(f.bodies):
        body, described = state.bodies[name], args.bodies[name]
        axes = Rotation.from_quat(np.asarray(body.quaternion), scalar_first=True).as_matrix()
        inertia = axes @ np.diag(described.inertia) @ axes.T
        block = matrix[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        np.testing.assert_allclose(block[:3, :3], float(described.mass) * np.eye(3), rtol=1e-15)
        np.testing.assert_allclose(block[3:, 3:], inertia, atol=1e-15 * np.abs(inertia).max())
        w = np.asarray(body.angular_velocity)
        energy += (float(described.mass) * np.sum(np.asarray(body.velocity) ** 2) + w @ inertia @ w) / 2
    v = np.asarray(f.velocities(0.0, y, args))
    assert v @ matrix @ v / 2 == pytest.approx(energy, rel=1e-14)
    assert float(f.energies(0.0, y, args).kinetic) == pytest.approx(energy, rel=1e-14)


def test_jacobian_and_bias_are_differences_of_the_residual():
    (f, _, args), run = moving("ideal")
    y, h = run.ys[-1], 1e-5
    residual = jax.jit(f.constraint_residual)
    jacobian = np.asarray(f.constraint_jacobian(0.0, y, args))
    for column in range(6 * len(f.bodies)):
        along = np.eye(6 * len(f.bodies))[column]
        difference = residual(0.0, moved(f, y, along, h), args) - residual(0.0, moved(f, y, along, -h), args)
        np.testing.assert_allclose(jacobian[:, column], difference / (2 * h), atol=1e-10)
    v = np.asarray(f.velocities(0.0, y, args))
    np.testing.assert_allclose(jacobian @ v, f.constraint_rate(0.0, y, args), atol=1e-13)
    # D v moves by -gamma where the velocities stay.
    ahead, behind = (np.asarray(f.constraint_jacobian(0.0, moved(f, y, v, dt), args)) @ v for dt in (h, -h))
    np.testing.assert_allclose(f.constraint_bias(0.0, y, args), -(ahead - behind) / (2 * h), atol=1e-7)
    assert f.constraint_rows["crank_pivot"] == slice(6, 11)


def test_rate_at_rest_is_what_a_driver_prescribes():
    body = sj.Body(1.0, (1e-2, 2e-2, 3e-2))
    hinge = sj.Revolute(("ground", "arm"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    drive = sj.RotationDriver(("ground", "arm"), (0.0, 0.0, 1.0), sj.functions.Polynomial([0.0, 2.0, 1.5]))
    scene = sj.Scene({"arm": body}, {"hinge": hinge, "drive": drive})
    f, y0, args = sj.ode(scene, t0=0.5)
    np.testing.assert_allclose(jax.jit(lambda t0: sj.ode(scene, t0=t0).y0)(0.5), y0, atol=1e-15)
    assert float(f.unpack(y0).bodies["arm"].angular_velocity[2]) == pytest.approx(2.0 + 2 * 1.5 * 0.5)
    rest = f.constraint_rate_at_rest(0.5, y0, args)[f.constraint_rows["drive"]]
    assert np.abs(rest) == pytest.approx(3.5)
    assert float(f.unpack(f(0.5, y0, args)).bodies["arm"].angular_velocity[2]) == pytest.approx(3.0)
    assert any("by itself" in said for said in f.left_to_the_integrator)


@pytest.mark.parametrize("name", EACH)
def test_accelerations_and_multipliers_solve_newton_euler(name):
    (f, _, args), run = moving(name)
    t, y = run.ts[-1], run.ys[-1]
    terms = (f.mass_matrix, f.accelerations, f.constraint_jacobian, f.lagrange_multipliers, f.applied_forces)
    M, a, D, multipliers, g = (np.asarray(term(t, y, args)) for term in terms)
    np.testing.assert_allclose(M @ a + D.T @ multipliers, g, atol=1e-11 * np.abs(g).max())
    right = f.constraint_bias(t, y, args) - f.constraint_feedback(t, y, args)
    np.testing.assert_allclose(D @ a, right, atol=1e-10 * np.abs(a).max())
    assert np.abs(multipliers).max() > 0.01


def test_projection_closes_what_was_opened_and_keeps_what_is_closed():
    (f, y0, args), _ = moving("ideal")
    opened = moved(f, y0, np.random.default_rng(0).normal(size=18) * 1e-3, 1.0)
    assert float(jnp.max(jnp.abs(f.constraint_residual(0.0, opened, args)))) > 1e-5
    closed = f.project(0.0, opened, args)
    assert float(jnp.max(jnp.abs(f.constraint_residual(0.0, closed, args)))) < 1e-15
    assert float(jnp.max(jnp.abs(f.project(0.0, y0, args) - y0))) < 1e-15


# Pure functions -------------------------------------------------------------------------------------------------------


def test_states_have_names_and_leading_axes():
    (f, y0, _), run = moving("friction")
    states = f.unpack(run.ys)
    np.testing.assert_array_equal(states.bodies["rocker"].position, run.position("rocker"))
    assert [float(x) > 0 for x in states.memory["coupler_rocker"]["onset_rate"]] == [False, False, True]
    np.testing.assert_array_equal(f.pack(states), run.ys)
    np.testing.assert_array_equal(f.pack(f.unpack(y0)), y0)


@pytest.mark.parametrize("name", EACH)
def test_derivatives_and_lanes_are_finite(name):
    (f, y0, args), run = moving(name)
    assert np.all(np.isfinite(jax.vmap(f, (None, 0, None))(0.0, run.ys, args)))

    def square(y, args):
        return jnp.sum(f(0.0, y, args) ** 2)

    for y in (y0, run.ys[-1]):
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(jax.jit(jax.grad(square, (0, 1)))(y, args)))


def test_derivatives_by_args_are_those_by_numbers_of_the_scene():
    """By a number that is traced in the scene, by the same in `args`, and by one that is zero."""
    (f, _, args), run = moving("bushing")
    y = run.ys[-1]
    weights = jnp.asarray(np.random.default_rng(1).normal(size=f.size))

    def of_scene(stiffness):
        return weights @ f(0.0, y, sj.ode(four_bar(sj.Bushing(stiffness, 1e-4), sj.solvers.Baumgarte())).args)

    def of_args(args):
        return weights @ f(0.0, y, args)

    slopes = jax.grad(of_args)(args)
    by_difference = (of_scene(1.001e6) - of_scene(0.999e6)) / 2e3
    assert float(jax.grad(of_scene)(1e6)) == pytest.approx(float(by_difference), rel=1e-7)
    assert float(slopes.joints["coupler_rocker"].model.law.stiffness) == pytest.approx(float(by_difference), rel=1e-7)
    sideways = [
        of_args(eqx.tree_at(lambda args: args.gravity, args, args.gravity + jnp.array([h, 0.0, 0.0])))
        for h in (1.0, -1.0)
    ]
    assert float(args.gravity[0]) == 0.0
    assert float(slopes.gravity[0]) == pytest.approx(float(sideways[0] - sideways[1]) / 2, rel=1e-9)
    assert abs(float(slopes.gravity[0])) > 1e-3


def test_args_of_traced_masses_fit_and_the_start_follows_numbers():
    (f, y0, args), _ = moving("ideal")

    def with_mass(mass):
        scene = four_bar(sj.Ideal(), sj.solvers.Baumgarte())
        return sj.ode(eqx.tree_at(lambda scene: scene.bodies["rocker"].mass, scene, mass, is_leaf=lambda x: x is None))

    mass = float(args.bodies["rocker"].mass)
    heavier = jax.jit(lambda mass: f(0.0, y0, with_mass(mass).args))(2 * mass)
    np.testing.assert_allclose(heavier, with_mass(2 * mass).f(0.0, y0, with_mass(2 * mass).args), atol=1e-9)
    np.testing.assert_allclose(f.start(0.0, args), y0, atol=1e-15)
    assert np.all(np.isnan(jax.jit(lambda mass: with_mass(mass).y0)(-1.0)))


def test_numbers_of_another_scene_are_refused():
    (f, y0, args), _ = moving("ideal")
    other = moving("bushing")[0]
    with pytest.raises(sj.SceneError, match="another structure than f was made of"):
        f(0.0, y0, other.args)
    with pytest.raises(sj.SceneError, match=r"arrays of other shapes .* jax\.vmap"):
        f(0.0, y0, jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), args))
    with pytest.raises(sj.SceneError, match=r"args must be the numbers of a scene.*NoneType"):
        f(0.0, y0, None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(sj.SceneError, match="a str is no scene"):
        sj.ode("four_bar")  # pyright: ignore[reportArgumentType]
    with pytest.raises(sj.SceneError, match=r"must have the shape \(39,\); it has \(\)"):
        f(y0, 0.0, args)  # pyright: ignore[reportArgumentType]
    with pytest.raises(sj.SceneError, match=r"shape \(39,\); it has \(38,\)"):
        f.constraint_residual(0.0, y0[1:], args)
    with pytest.raises(sj.SceneError, match=r"it has \(38,\)"):
        f.unpack(y0[1:])
    with pytest.raises(sj.SceneError, match=r"n_corrections = -1 must be a whole number"):
        f.project(0.0, y0, args, -1)
    with pytest.raises(sj.SceneError, match="has no contacts"):
        f.crossings(0.0, y0, args)
    dry, y0, args = moving("dry")[0]
    with pytest.raises(sj.SceneError, match=r"no dictionary by joint.*'coupler_rocker': True"):
        dry.after_contact(0.0, y0, args, [True])
    with pytest.raises(sj.SceneError, match=r"'wheel' have no contact; the contacts are 'coupler_rocker'"):
        dry.after_contact(0.0, y0, args, {"wheel": True})


# In plain diffrax -----------------------------------------------------------------------------------------------------


def by_diffrax(f, solver, t0, t1, y0, args, **more):
    control = diffrax.PIDController(rtol=1e-9, atol=1e-11, dtmax=2e-4 if f.contacts else None)
    return diffrax.diffeqsolve(
        diffrax.ODETerm(f), solver, t0, t1, 1e-6, y0, args, stepsize_controller=control, max_steps=100_000, **more
    )


def largest_difference(run, f, y) -> float:
    """Of positions [m] at the end."""
    bodies = f.unpack(y).bodies
    return max(float(jnp.max(jnp.abs(run.position(name)[-1] - bodies[name].position))) for name in f.bodies)


@pytest.mark.parametrize(
    ("name", "solver"),
    [("ideal", diffrax.Tsit5()), pytest.param("bushing", diffrax.Kvaerno5(), marks=pytest.mark.slow)],
    ids=["ideal", "bushing"],
)
def test_plain_diffrax_makes_the_same_motion(name, solver):
    (f, y0, args), run = moving(name)
    assert not f.has_events
    solution = by_diffrax(f, solver, 0.0, 8e-3, y0, args)
    assert largest_difference(run, f, solution.ys[-1]) < 1e-11


@pytest.mark.slow
def test_a_gradient_through_plain_diffrax_is_that_of_the_run():
    f = moving("bushing")[0].f

    def scene_of(stiffness):
        return four_bar(sj.Bushing(stiffness, 1e-4), sj.solvers.Baumgarte())

    def height(stiffness):
        _, y0, args = sj.ode(scene_of(stiffness))
        return f.unpack(by_diffrax(f, diffrax.Tsit5(), 0.0, 8e-3, y0, args).ys[-1]).bodies["rocker"].velocity[2]

    def of_run(stiffness):
        return sj.simulate(scene_of(stiffness), jnp.array([0.0, 8e-3])).velocity("rocker")[-1, 2]

    assert float(jax.grad(height)(1e6)) == pytest.approx(float(jax.grad(of_run)(1e6)), rel=1e-4)


def test_a_dry_run_is_rebuilt_by_events_and_restarts():
    """Four impacts of the four-bar: onset and release found by diffrax, each a restart behind `after_contact`."""
    scene = four_bar(MODELS_HERE["friction"], sj.solvers.Baumgarte())
    f, y, args = sj.ode(scene)
    assert f.has_events
    assert f.contacts == ("coupler_rocker",)
    event = diffrax.Event(f.contact_events, optx.Newton(1e-10, 1e-12), direction=False)

    @eqx.filter_jit
    def stretch(t, y, args):
        return by_diffrax(f, diffrax.Tsit5(), t, 0.02, y, args, event=event)

    t, n_events = 0.0, 0
    while True:
        solution = stretch(t, y, args)
        t, y = solution.ts[-1], solution.ys[-1]
        if solution.result != diffrax.RESULTS.event_occurred:
            break
        assert abs(float(f.crossings(t, y, args).value[0])) < 1e-10
        y = f.after_contact(t, y, args, solution.event_mask)
        n_events += 1
    run = sj.simulate(scene, jnp.array([0.0, 0.02]), rtol=1e-10)
    assert n_events == 2 * int(run.stats.n_onsets[0]) == 8
    assert largest_difference(run, f, y) < 1e-10
    assert float(jnp.max(jnp.abs(run.velocity("rocker")[-1] - f.unpack(y).bodies["rocker"].velocity))) < 1e-7


def test_samples_of_a_controller_are_restarts():
    f, y, args = sj.ode(sampled_motor(0.01))
    assert f.samplers == ("motor",)
    assert f.has_events

    @jax.jit
    def stretch(t, y, args):
        y = f.after_samples(t, y, args)
        end = jnp.minimum(f.next_samples(t, y, args)[0], 0.045)
        return end, by_diffrax(f, diffrax.Tsit5(), t, end, y, args).ys[-1]

    t = jnp.array(0.0)
    while float(t) < 0.045:
        t, y = stretch(t, y, args)
    expected = sampled_answer(np.array([0.045]))
    assert float(f.unpack(y).bodies["rotor"].angular_velocity[2]) == pytest.approx(float(expected[0, 1]), rel=1e-8)


def test_what_is_left_to_the_integrator_is_said():
    dry = sj.ode(sj.gallery.four_bar(sj.Dry(1e-4), drift=sj.solvers.PostStabilization())).f
    said = " ".join(dry.left_to_the_integrator)
    assert "'coupler_rocker' begins and ends" in said
    assert "`project`" in said
    assert moving("ideal")[0].f.left_to_the_integrator == ()
    assert "rocker" in repr(dry)
