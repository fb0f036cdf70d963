"""The automatic choice of method and tolerances: what it is, that it is explained, and that it can be overridden."""

import sys
from pathlib import Path

import cases
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers import automatic
from spherejax.motion.solvers.automatic import choose_solver, explicit_rate_limit
from spherejax.motion.solvers.friction_rates import eigenvalues_and_participation
from spherejax.motion.solvers.joint_rates import (
    fastest_in_clearance,
    pressed_actions,
    rates_in_clearance,
    rates_under_load,
)
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.start.tolerances import component_tolerances
from spherejax.program_cache import folders

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))


def system_of(model, **options):
    return compile_scene(sj.gallery.four_bar(model, **options)).system


def chosen(model, rtol=1e-8):
    return type(choose_solver(system_of(model), rtol).solver)


def test_an_explicit_method_where_nothing_is_stiff():
    assert chosen(sj.Ideal()) is diffrax.Dopri8
    assert chosen(sj.Dry(1e-4, friction=sj.Threlfall())) is diffrax.Dopri8
    assert chosen(sj.Bushing(1e6, 1e-4)) is diffrax.Dopri8


def test_a_stiff_method_for_films_and_stiff_bushings():
    assert chosen(sj.Lubricated(1e-4)) is sj.solvers.Rodas5P
    assert chosen(sj.Bushing(1e6, 1e-1)) is sj.solvers.Rodas5P
    assert chosen(sj.Bushing(1e8, 1e-2)) is sj.solvers.Rodas5P


def test_the_choice_depends_on_the_tolerance():
    """At a loose tolerance a stiff method needs few steps, while stability holds the explicit one to as many."""
    assert chosen(sj.Bushing(1e6, 1e-2), 1e-10) is diffrax.Dopri8
    assert chosen(sj.Bushing(1e6, 1e-2), 1e-5) is sj.solvers.Ros34PW2
    assert explicit_rate_limit(1e-10) > explicit_rate_limit(1e-8) > explicit_rate_limit(1e-6)


def test_rate_of_an_elastomer_between_free_bodies():
    """Two masses m1, m2 and an elastomer: decay k b (1/m1 + 1/m2), frequency (k (1/m1 + 1/m2))^(1/2)."""

    def rate(k, b):
        body = {"c": (0.0, 0.0, 0.0)}
        scene = sj.Scene(
            {"a": sj.Body(2.0, (1e-3,) * 3, points=body), "b": sj.Body(3.0, (1e-3,) * 3, points=body)},
            {"j": sj.Spherical("a.c", "b.c", sj.Bushing(k, b))},
        )
        structure, theta = flatten_system(compile_scene(scene).system)
        return float(rates_in_clearance(structure, theta)[0])

    mobility = 1 / 2.0 + 1 / 3.0
    assert rate(1e6, 1e-2) == pytest.approx(1e4 * mobility, rel=1e-9)
    assert rate(1e6, 0.0) == pytest.approx((1e6 * mobility) ** 0.5, rel=1e-9)


def hanging_ball(model, mass=2.0):
    """A body that hangs in a socket at its center of mass: the load is its weight, and nothing else is joined."""
    body = sj.Body(mass, (1e-2,) * 3, points={"ball": (0.0, 0.0, 0.0)})
    joint = sj.Spherical("ground.socket", "body.ball", model)
    return compile_scene(sj.Scene({"body": body}, {"joint": joint}, ground_points={"socket": (0.0, 0.0, 0.0)})).system


def test_rate_of_friction_under_load():
    """Slope mu F / v1 of Threlfall's law at rest (kappa = 1), by the mobility of the surface 1/m + R^2/J; F is three
    times the weight."""
    model = sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-6))
    structure, theta = flatten_system(hanging_ball(model))
    slope = float(np.linalg.norm(model.friction.traction(np.array([1e-12, 0.0, 0.0]), 3 * 2.0 * 9.81))) / 1e-12
    expected = slope * (1 / 2.0 + (1e-2 - 1e-4) ** 2 / 1e-2)
    assert rates_under_load(structure, theta, 1.0)[0] == pytest.approx(expected, rel=1e-4)


def test_a_contact_that_is_held_by_friction_is_stiff_and_one_that_vibrates_is_not():
    assert chosen(sj.Dry(1e-4, friction=sj.Threlfall())) is diffrax.Dopri8
    held = compile_scene(sj.gallery.suspension(sj.Dry(1e-4, friction=sj.Threlfall()))).system
    choice = choose_solver(held, 1e-8)
    assert isinstance(choice.solver, sj.solvers.Rodas5P)
    assert "'wheel_a_arm' resists under load" in choice.reason
    assert isinstance(choose_solver(held, 1e-5).solver, sj.solvers.Ros34PW2)


def test_a_film_is_looked_at_under_load_where_the_load_presses_through_it():
    # Damped by the onset's speed the contact is stiff; the memory-free default is not.
    model = sj.Lubricated(1e-4, viscosity=0.4, normal=sj.LankaraniNikravesh(0.9))
    light, heavy = (hanging_ball(model, mass) for mass in (1.0, 10.0))
    rates = [float(rates_under_load(*flatten_system(system), 0.1)[0]) for system in (light, heavy)]
    assert rates[0] == 0.0
    assert rates[1] > 0.0


@pytest.mark.parametrize("name", ["lubricated", "lubricated_lugre", "lubricated_liner", "dry_profile"])
def test_what_is_looked_at_before_a_run_compiles_nothing(name):
    """As array code it would be compiled operation by operation, which took longer than the run."""
    system = compile_scene(sj.gallery.four_bar(cases.MODELS[name])).system
    structure, theta = flatten_system(system)
    found = rates_under_load(structure, np.asarray(theta), 1.0)
    assert np.all(found >= 0)
    program = program_for(pressed_actions, structure, is_computed=True)
    assert program.scalar is not None
    with pytest.raises(AssertionError, match="to be computed only"):
        jax.jit(program)(jnp.asarray(theta), 0.0, jnp.zeros(system.layout.size))


def test_numbers_hidden_by_jit_leave_the_choice_to_the_models_or_to_the_start():
    @jax.jit
    def reasons(k):
        bushing = choose_solver(system_of(sj.Bushing(k, 1e-2)))
        film = choose_solver(system_of(sj.Lubricated(1e-4, viscosity=k)))
        friction = choose_solver(system_of(sj.Dry(k, friction=sj.Threlfall())))
        assert isinstance(bushing.solver, diffrax.Dopri8)
        assert isinstance(bushing.at_start.solver, sj.solvers.Ros34PW2)
        assert bushing.at_start.limit > explicit_rate_limit(1e-6)  # less at a looser tolerance
        assert "when the run starts" in bushing.reason
        for choice, solver in ((film, sj.solvers.Rodas5P), (friction, diffrax.Dopri8)):
            assert isinstance(choice.solver, solver)
            assert choice.at_start is None
            assert "traced" in choice.reason
        return k

    reasons(1e6)


def test_numbers_behind_derivatives_and_lanes_are_looked_at():
    """Outside `jax.jit` JAX knows the numbers: the choice is that of the same numbers without a transformation."""
    found = []

    def looked(k, b=1e-2):
        found.append(choose_solver(system_of(sj.Bushing(k, b)), 1e-5))
        return 1.0 * k

    k = 1e6
    known = choose_solver(system_of(sj.Bushing(k, 1e-2)), 1e-5)
    assert isinstance(known.solver, sj.solvers.Ros34PW2)
    jax.jvp(looked, (k,), (1.0,))
    jax.grad(looked)(k)
    jax.vjp(looked, k)
    jax.hessian(looked)(k)
    jax.vmap(jax.grad(looked))(jnp.array([k, k]))
    assert [choice.reason for choice in found] == [known.reason] * len(found)
    found.clear()
    # One stiff lane of four decides, also where two axes are mapped; none, where none is stiff.
    jax.vmap(looked)(jnp.array([1e3, 1e3, k, 1e3]))
    jax.vmap(jax.vmap(looked, (None, 0)), (0, None))(jnp.array([1e3, k]), jnp.array([1e-6, 1e-2]))
    jax.vmap(looked)(jnp.array([1e3, 1e3]))
    assert [type(choice.solver) for choice in found] == [sj.solvers.Ros34PW2, sj.solvers.Ros34PW2, diffrax.Dopri8]


@pytest.mark.parametrize(("k", "b"), [(1e3, 1e-6), (1e6, 1e-2), (1e8, 1e-1), (1e6, 0.0)])
def test_the_rate_at_the_start_of_a_traced_run_is_that_of_a_known_one(k, b):
    """By powers of matrices instead of eigenvalues: never less, at most 3^(1/16) more."""
    structure, theta = flatten_system(system_of(sj.Bushing(k, b)))
    known = float(np.max(rates_in_clearance(structure, theta)))
    traced = float(fastest_in_clearance(structure, None, jnp.asarray(theta)))
    assert known * (1 - 1e-9) <= traced <= known * 3 ** (1 / 16)


def test_both_methods_are_in_a_run_that_chooses_at_its_start(monkeypatch):
    monkeypatch.setattr(folders, "_in_use", [])  # a run that is kept is one operation

    def simulated(stiffness, solver=None):
        scene = sj.gallery.four_bar(sj.Bushing(stiffness, 1e-4))
        return sj.simulate(scene, jnp.array([0.0, 0.005]), solver=solver).ys

    def loops(function):
        return str(jax.make_jaxpr(function)(1e6)).count("= runs[")

    assert loops(jax.jit(simulated)) == 2
    assert loops(jax.jit(lambda k: simulated(k, diffrax.Dopri8()))) == 1


@pytest.mark.slow
def test_each_lane_of_a_traced_run_takes_the_method_that_its_numbers_call_for():
    ts = jnp.linspace(0.0, 0.02, 5)
    dampings = np.array([1e-4, 1e-1, 1e-3, 1.0])

    def run(damping):
        return sj.simulate(sj.gallery.four_bar(sj.Bushing(1e6, damping)), ts, rtol=1e-6)

    runs = jax.jit(jax.vmap(run))(dampings)
    stages = np.asarray(runs.stats.n_evaluations) / np.asarray(runs.stats.n_steps)
    known = [run(float(damping)) for damping in dampings]
    assert [type(choose_solver(each.system, 1e-6).solver) for each in known] == [
        diffrax.Dopri8, sj.solvers.Ros34PW2, diffrax.Dopri8, sj.solvers.Ros34PW2
    ]  # fmt: skip
    np.testing.assert_array_equal(stages, [float(each.stats.n_evaluations / each.stats.n_steps) for each in known])
    assert set(stages) == {13.0, 4.0}
    assert np.all(np.asarray(runs.status) == 0)
    for lane, each in enumerate(known):
        # Other steps, for a known stiff run is made by diffrax: alike within some tolerances, in m, m/s and rad/s. Such
        # runs are off by 2e-6 to 4e-5 as their steps happen to fall (24 dampings from 0.8 to 1.2).
        np.testing.assert_allclose(runs.ys[lane], each.ys, rtol=0, atol=1e-4)


def test_the_run_explains_method_and_tolerances():
    scene = sj.gallery.four_bar(sj.Bushing(1e6, 1e-4))
    ts = jnp.array([0.0, 0.005])
    run = sj.simulate(scene, ts, rtol=1e-6)
    for said in ("Dopri8", "coupler_rocker", "per second", "rtol 1e-06", "m/s", "rad/s"):
        assert said in run.stats.explanation
    asked = sj.simulate(scene, ts, rtol=1e-6, atol=1e-8, solver=diffrax.Tsit5())
    assert "Tsit5: as asked for" in asked.stats.explanation
    assert "first step by trial" in asked.stats.explanation
    assert "tolerances as asked for" in asked.stats.explanation
    constant = sj.simulate(scene, ts, stepsize_controller=diffrax.PIDController(rtol=1e-5, atol=1e-7))
    assert "PIDController: as asked for" in constant.stats.explanation


@pytest.mark.parametrize(
    ("solver", "is_known", "adjoint", "said"),
    [
        (diffrax.Dopri8(), True, None, "by trial (Hairer)"),
        (diffrax.Dopri8(), True, diffrax.ForwardMode(), "by trial (Hairer)"),
        (diffrax.Dopri8(), True, diffrax.DirectAdjoint(), "by trial (Hairer)"),
        (sj.solvers.Rodas5P(), False, None, "by trial (Hairer)"),
        (sj.solvers.Rodas5P(), True, None, "by trial (Hairer)"),
        (diffrax.Kvaerno5(), True, None, "by trial (Hairer)"),
    ],
)
def test_the_run_says_how_it_begins(solver, is_known, adjoint, said):
    """Traced only: nothing is compiled."""
    found = []

    def simulated(stiffness):
        scene = sj.gallery.four_bar(sj.Bushing(1e6 if is_known else stiffness, 1e-4))
        run = sj.simulate(scene, jnp.array([0.0, 0.005]), solver=solver, adjoint=adjoint, max_steps=100)
        found.append(run.stats.explanation)
        return run.status

    jax.eval_shape(simulated, 1e6)
    assert f"first step {said}" in found[0]


def test_positions_are_judged_against_the_clearance():
    fine, usual = (component_tolerances(system_of(sj.Dry(c)), 1e-8) for c in (1e-6, 1e-4))
    layout = system_of(sj.Dry(1e-4)).layout
    assert fine.rtol[0] < 0.2 * usual.rtol[0]
    assert fine.rtol[0] * 0.2 < 1e-2 * 1e-6  # a hundredth of the clearance, at a position of 0.2 m
    np.testing.assert_array_equal(fine.rtol[layout.n_position :], usual.rtol[layout.n_position :])
    np.testing.assert_array_equal(fine.rtol[3:7], usual.rtol[3:7])  # the quaternion
    assert np.all(usual.atol > 0)
    assert usual.atol.shape == usual.rtol.shape == (layout.size,)


def test_small_clearance_is_resolved_at_a_usual_tolerance():
    """Clearance 1 um: penetrations of 1e-8 m beside positions of 0.1 m; against a run a hundred times tighter."""
    scene = sj.gallery.four_bar(sj.Dry(1e-6, friction=sj.Threlfall()))
    ts = jnp.linspace(0.0, 0.01, 11)
    usual, tight = (sj.simulate(scene, ts, rtol=rtol).require_success() for rtol in (1e-8, 1e-11))
    error = np.max(np.abs(usual.eccentricity("coupler_rocker") - tight.eccentricity("coupler_rocker")))
    assert error < 1e-3 * 1e-6
    assert int(usual.stats.n_onsets[0]) == int(tight.stats.n_onsets[0]) > 0


def test_tolerances_follow_traced_numbers():
    def first_rtol(c):
        return jnp.asarray(component_tolerances(system_of(sj.Dry(c)), 1e-8).rtol)[0]

    traced = jax.vmap(first_rtol)(jnp.array([1e-6, 1e-4]))
    concrete = [first_rtol(c) for c in (1e-6, 1e-4)]
    np.testing.assert_allclose(traced, concrete, rtol=1e-12)


def test_a_run_that_is_differentiated_is_judged_by_the_numbers_of_the_plain_one():
    """And says them; under `jax.jit` they are hidden, and come to the same."""
    ts, seen = jnp.array([0.0, 0.005]), []

    def height(c):
        run = sj.simulate(sj.gallery.four_bar(sj.Dry(c)), ts, rtol=1e-8)
        seen.append(run.stats.explanation)
        return run.position("rocker")[-1, 2]

    c = 1e-4
    height(c)
    slope, hidden = jax.grad(height)(c), jax.jit(jax.grad(height))(c)
    plain, differentiated, _ = seen
    said = "atol 1e-11 m, 1e-10 m/s"
    assert said in plain
    assert said in differentiated
    np.testing.assert_allclose(slope, hidden, rtol=1e-9)


def test_a_traced_tolerance_and_a_derivative_together():
    ts = jnp.array([0.0, 0.005])

    @jax.jit
    def slope(k, rtol):
        def height(k):
            return sj.simulate(sj.gallery.four_bar(sj.Bushing(k, 1e-4)), ts, rtol=rtol).position("rocker")[-1, 2]

        return jax.jvp(height, (k,), (1.0,))

    value, derivative = slope(1e6, 1e-8)
    other, _ = slope(1e6 + 100.0, 1e-8)
    assert float(derivative) == pytest.approx(float(other - value) / 100.0, rel=1e-2)


def test_default_root_finders_are_replaced_and_others_kept():
    import optimistix

    assert with_converging_root_finder(diffrax.Kvaerno5(), 1e-6) == diffrax.Kvaerno5()  # stepped in our own loop
    replaced = with_converging_root_finder(diffrax.Kvaerno5(), 1e-6, makes_own_steps=True)
    assert isinstance(replaced.root_finder, optimistix.Chord)
    assert float(replaced.root_finder.rtol) == pytest.approx(1e-7)
    own = diffrax.Kvaerno5(root_finder=diffrax.VeryChord(rtol=1e-9, atol=1e-9))
    newton = diffrax.Kvaerno3(root_finder=optimistix.Newton(rtol=1e-9, atol=1e-9))
    explicit = diffrax.Dopri8()
    for solver in (own, newton, explicit):
        assert with_converging_root_finder(solver, 1e-6, makes_own_steps=True) is solver


@pytest.mark.slow
def test_an_implicit_method_converges_on_a_stiff_bushing():
    scene, ts = sj.gallery.four_bar(sj.Bushing(1e6, 1e-2)), jnp.linspace(0.0, 0.02, 5)
    run = sj.simulate(scene, ts, rtol=1e-6, atol=1e-8, solver=diffrax.Kvaerno5()).require_success()
    tight = sj.simulate(scene, ts, rtol=1e-10).require_success()
    assert int(run.stats.n_rejected) < int(run.stats.n_accepted)
    np.testing.assert_allclose(run.position("rocker"), tight.position("rocker"), atol=1e-6)


def test_the_compiled_run_does_not_call_back_into_python():
    """JAX's persistent cache keeps no program that does."""

    def height(c):
        scene = sj.gallery.four_bar(sj.Dry(c, friction=sj.Threlfall()))
        return sj.simulate(scene, jnp.array([0.0, 0.005])).position("rocker")[-1, 2]

    assert "callback" not in jax.jit(height).lower(1e-4).as_text()


# Controllers, and mechanisms whose linear systems are large ----------------------------------------------------------


def controlled(model, **gains):
    scene = sj.gallery.four_bar(model)
    motor = sj.PID(sj.Turn(("ground", "crank"), axis=(0.0, 1.0, 0.0)), 0.0, proportional=10.0, derivative=1.0, **gains)
    return compile_scene(sj.Scene(scene.bodies, scene.joints, {"motor": motor}, ground_points=scene.ground_points))


@pytest.mark.parametrize(
    ("model", "filter_time", "rtol", "solver", "said"),
    [
        (sj.Lubricated(1e-4), 1e-3, 1e-8, sj.solvers.Rodas5P, "joint 'coupler_rocker' acts"),
        (sj.Lubricated(1e-4), 1e-3, 1e-5, sj.solvers.Ros34PW2, "joint 'coupler_rocker' acts"),
        (
            sj.Lubricated(1e-4),
            1e-7,
            1e-5,
            sj.solvers.Rodas5P,
            "the states of force element 'motor' change at about 1.0e+07",
        ),
        (sj.Dry(1e-4), 1e-7, 1e-8, sj.solvers.Rodas5P, "the states of force element 'motor' change at about 1.0e+07"),
    ],
)
def test_the_explanation_names_the_part_that_decides(model, filter_time, rtol, solver, said):
    choice = choose_solver(controlled(model, filter_time=filter_time).system, rtol)
    assert isinstance(choice.solver, solver)
    assert choice.reason.startswith(f"{solver.__name__}: {said}")


def test_loads_at_the_start_are_those_of_controllers_that_have_settled():
    """A filter that starts at zero would see an error of 1 rad as new: a kick of 1 N m s/rad / 1 us = 1e6 N m."""
    model = sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1))

    def rate(derivative):
        hanging = sj.Body(2.0, (1e-2,) * 3, position=(0.1, 0.0, 0.0), points={"ball": (-0.1, 0.0, 0.0)})
        motor = sj.PID(
            sj.Turn(("ground", "body"), axis=(0.0, 1.0, 0.0)), 1.0,
            proportional=0.0, derivative=derivative, filter_time=1e-6,
        )  # fmt: skip
        joint = sj.Spherical("ground.socket", "body.ball", model)
        scene = sj.Scene({"body": hanging}, {"joint": joint}, {"motor": motor}, ground_points={"socket": (0, 0, 0)})
        structure, theta = flatten_system(compile_scene(scene).system)
        return float(rates_under_load(structure, theta, 1.0)[0])

    assert rate(1.0) == pytest.approx(rate(0.0), rel=1e-9)


def test_participation_of_states():
    """Of a triangular matrix each eigenvalue's own state; of a vibration both states half."""
    matrix = np.array([[-1.0, 5.0, 0.0, 0.0], [0.0, -1e3, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -9.0, 0.0]])
    values, shares = eigenvalues_and_participation(matrix)
    fast, vibration = int(np.argmin(values.real)), int(np.argmax(values.imag))
    assert values[fast] == pytest.approx(-1e3)
    np.testing.assert_allclose(shares[:, fast], [0, 1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(shares[:, vibration], [0, 0, 0.5, 0.5], atol=1e-9)


def test_dense_linear_systems_raise_the_price_of_a_stiff_method(monkeypatch):
    system = system_of(sj.Bushing(1e6, 1e-1))
    assert isinstance(choose_solver(system, 1e-8).solver, sj.solvers.Rodas5P)
    monkeypatch.setattr(automatic, "systems_of", lambda structure: None)
    monkeypatch.setattr(automatic, "ARRAY_ELIMINATION", 100 * automatic.ARRAY_ELIMINATION)
    dear = choose_solver(system, 1e-8)
    assert isinstance(dear.solver, diffrax.Dopri8)
    assert "(Rodas5P would solve dense linear systems of this size)" in dear.reason


@pytest.mark.slow
def test_a_stewart_platform_with_a_film_is_left_to_the_explicit_method():
    """A step of Rodas5P takes 3 ms there, 25 of Dopri8: `benchmarks/automatic_mechanisms.py`."""
    from stewart import stewart_platform

    for model in (sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1)), sj.Lubricated(1e-4), sj.Bushing(1e6, 1e-1)):
        assert isinstance(choose_solver(compile_scene(stewart_platform(model)).system, 1e-8).solver, diffrax.Dopri8)
