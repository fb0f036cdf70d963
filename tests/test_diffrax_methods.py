"""Every solver and step-size controller of diffrax either integrates a mechanism or is refused in words."""

import inspect

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from cases import ball_in_socket, pendulum

import spherejax as sj

TS = jnp.linspace(0.0, 0.2, 21)

TAKEN = {
    "Bosh3": diffrax.Bosh3(),
    "Dopri5": diffrax.Dopri5(),
    "Dopri8": diffrax.Dopri8(),
    "HalfSolver": diffrax.HalfSolver(diffrax.Tsit5()),
    "Heun": diffrax.Heun(),
    "ImplicitEuler": diffrax.ImplicitEuler(),
    "Kvaerno3": diffrax.Kvaerno3(),
    "Kvaerno4": diffrax.Kvaerno4(),
    "Kvaerno5": diffrax.Kvaerno5(),
    "Midpoint": diffrax.Midpoint(),
    "Ralston": diffrax.Ralston(),
    "ReversibleHeun": diffrax.ReversibleHeun(),
    "Tsit5": diffrax.Tsit5(),
}
"""Solvers that choose their steps by a tolerance."""

WITHOUT_ERROR = {"Euler": diffrax.Euler(), "LeapfrogMidpoint": diffrax.LeapfrogMidpoint()}

OF_SEVERAL_TERMS = {
    *("ALIGN", "EulerHeun", "GeneralShARK", "ItoMilstein", "KenCarp3", "KenCarp4", "KenCarp5", "QUICSORT", "SEA"),
    *("SPaRK", "SRA1", "SemiImplicitEuler", "ShARK", "ShOULD", "Sil3", "SlowRK", "StratonovichMilstein"),
}


def scene_of(stiffness=None):
    """A pendulum, or a ball in an elastic bushing."""
    return pendulum() if stiffness is None else ball_in_socket(sj.Bushing(stiffness, 1.0), velocity=(0.1, 0.0, 0.05))


@pytest.fixture(scope="module")
def reference():
    return sj.simulate(scene_of(), TS, rtol=1e-11).position("bob")


def test_every_solver_of_diffrax_is_in_one_of_the_lists():
    classes = {
        name
        for name, value in vars(diffrax).items()
        if inspect.isclass(value) and issubclass(value, diffrax.AbstractSolver) and not inspect.isabstract(value)
    }
    classes = {name for name in classes if not name.startswith("Abstract")}
    assert classes == {*TAKEN, *WITHOUT_ERROR, *OF_SEVERAL_TERMS}


@pytest.mark.parametrize("name", [name for name in TAKEN if name != "ImplicitEuler"])
def test_a_solver_integrates_a_pendulum_to_its_tolerance(name, reference):
    run = sj.simulate(scene_of(), TS, rtol=1e-6, solver=TAKEN[name])
    assert bool(run.succeeded), run.diagnosis
    np.testing.assert_allclose(run.position("bob"), reference, atol=1e-4)
    assert run.constraint_violation.max() < 1e-10


def test_the_audit_ends_what_implicit_euler_does_to_a_pendulum():
    """Its steps take energy away, at first order; what is damped anyway it integrates."""
    with pytest.warns(sj.SimulationWarning, match="energy vanished"):
        run = sj.simulate(scene_of(), TS, rtol=1e-5, solver=TAKEN["ImplicitEuler"])
    assert run.status == sj.Status.AUDIT_FAILED
    damped = scene_of(1e4)
    run = sj.simulate(damped, TS, rtol=1e-5, solver=TAKEN["ImplicitEuler"])
    np.testing.assert_allclose(run.position("ball"), sj.simulate(damped, TS).position("ball"), atol=1e-7)


@pytest.mark.parametrize("name", sorted(OF_SEVERAL_TERMS))
def test_a_solver_of_several_terms_is_refused(name):
    kind = getattr(diffrax, name)
    arguments = {"QUICSORT": (0.1,), "ALIGN": (0.1,), "ShOULD": (0.1,)}.get(name, ())
    with pytest.raises(sj.SceneError, match=rf"{name}\(\) integrates sums of terms .*Kvaerno5"):
        sj.simulate(scene_of(), TS, solver=kind(*arguments))


@pytest.mark.parametrize("name", WITHOUT_ERROR)
def test_a_solver_without_an_estimate_needs_the_ends_of_its_steps(name, reference):
    solver = WITHOUT_ERROR[name]
    with pytest.raises(sj.SceneError, match=rf"{name}\(\) estimates no error, .*HalfSolver.*StepTo"):
        sj.simulate(scene_of(), TS, solver=solver)
    steps = diffrax.StepTo(ts=jnp.linspace(0.0, 0.2, 4001))
    run = sj.simulate(scene_of(), TS, solver=solver, stepsize_controller=steps)
    assert int(run.stats.n_steps) == 4000
    error = np.abs(run.position("bob") - reference).max()
    assert error < (1e-4 if name == "Euler" else 1e-7)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"stepsize_controller": diffrax.ConstantStepSize()}, "knows no size.*StepTo"),
        ({"stepsize_controller": diffrax.PIDController}, "PIDController is a class; give an object"),
        ({"stepsize_controller": 1e-3}, "stepsize_controller = 0.001 is none of diffrax's"),
        ({"stepsize_controller": diffrax.StepTo(ts=jnp.array([0.0, 0.1]))}, "the run goes from 0 s to 0.2 s"),
        ({"stepsize_controller": diffrax.StepTo(ts=jnp.array([0.0, 0.1, 0.1, 0.2]))}, "times that increase"),
        ({"adjoint": "x"}, "adjoint = 'x' is none of diffrax's"),
        ({"adjoint": diffrax.BacksolveAdjoint}, "BacksolveAdjoint is a class"),
        ({"solver": diffrax.Dopri8}, "give an object"),
    ],
)
def test_what_does_not_fit_is_answered(asked, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.simulate(scene_of(), TS, **asked)


@pytest.mark.slow
def test_steps_that_are_given_end_on_contacts_as_well(reference):
    scene = sj.gallery.four_bar(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-3)))
    ts = jnp.linspace(0.0, 0.02, 11)
    tight = sj.simulate(scene, ts, rtol=1e-10)
    run = sj.simulate(scene, ts, stepsize_controller=diffrax.StepTo(ts=jnp.linspace(0.0, 0.02, 4001)))
    assert int(run.stats.n_onsets.sum()) == int(tight.stats.n_onsets.sum()) > 0
    np.testing.assert_allclose(run.position("rocker"), tight.position("rocker"), atol=1e-9)


def test_controllers_of_a_users_own_serve_vmap_and_derivatives():
    clipped = diffrax.ClipStepSizeController(diffrax.PIDController(rtol=1e-8, atol=1e-10), step_ts=[0.05, 0.15])

    def height(stiffness, **how):
        return sj.simulate(scene_of(stiffness), TS, **how).position("ball")[-1, 0]

    stiffnesses = jnp.array([1e4, 1.5e4])
    own, theirs = (jax.vmap(jax.value_and_grad(lambda k, how=how: height(k, **how)))(stiffnesses) for how in (
        {"rtol": 1e-9}, {"stepsize_controller": clipped}
    ))  # fmt: skip
    np.testing.assert_allclose(theirs[0], own[0], atol=1e-9)
    np.testing.assert_allclose(theirs[1], own[1], rtol=1e-4)


def test_derivatives_by_an_implicit_method_are_controlled():
    def height(stiffness, solver, rtol):
        return sj.simulate(scene_of(stiffness), TS, rtol=rtol, solver=solver).position("ball")[-1, 0]

    tight = float(jax.grad(height)(1e4, diffrax.Dopri8(), 1e-11))
    assert jax.grad(height)(1e4, diffrax.Kvaerno5(), 1e-8) == pytest.approx(tight, rel=1e-4)
    assert jax.jacfwd(height)(1e4, diffrax.HalfSolver(diffrax.Tsit5()), 1e-8) == pytest.approx(tight, rel=1e-4)


def test_an_implicit_method_in_half_steps():
    run = sj.simulate(scene_of(1e4), TS, rtol=1e-7, solver=diffrax.HalfSolver(diffrax.Kvaerno3()))
    np.testing.assert_allclose(run.position("ball"), sj.simulate(scene_of(1e4), TS).position("ball"), atol=1e-7)


def test_steps_that_are_given_serve_an_adjoint_of_diffrax_too():
    steps = diffrax.StepTo(ts=jnp.linspace(0.0, 0.2, 201))

    def height(speed, **how):
        scene = ball_in_socket(sj.Bushing(10.0, 0.01), velocity=(speed, 0.0, 0.05))
        return sj.simulate(scene, TS, stepsize_controller=steps, **how).position("ball")[-1, 0]

    adjoint = {"adjoint": diffrax.RecursiveCheckpointAdjoint(), "max_steps": 1000}
    assert jax.grad(lambda v: height(v, **adjoint))(0.1) == pytest.approx(float(jax.grad(height)(0.1)), rel=1e-6)


def test_sweeps_and_steps_by_hand_refuse_them_too():
    for solver, said in ((diffrax.KenCarp4(), "sums of terms"), (diffrax.Euler(), "estimates no error")):
        with pytest.raises(sj.SceneError, match=said):
            sj.sweep(scene_of, {"stiffness": [1e4]}, TS, record=["final position.ball"], solver=solver, progress=False)
        with pytest.raises(sj.SceneError, match=said):
            sj.start(scene_of(), solver=solver)


def test_a_root_finder_of_ones_own_stays():
    newton = diffrax.Kvaerno3(root_finder=optimistix.Newton(rtol=1e-9, atol=1e-9))
    run = sj.simulate(scene_of(1e4), TS, rtol=1e-6, solver=newton)
    tight = sj.simulate(scene_of(1e4), TS, rtol=1e-9)
    np.testing.assert_allclose(run.position("ball"), tight.position("ball"), atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [sj.Dry(clearance=1e-4), sj.Bushing(stiffness=1e6, damping=1e2)], ids=["dry", "bushing"]
)
def test_an_implicit_method_takes_few_evaluations_through_contact(model):
    scene, ts = sj.gallery.four_bar(model), jnp.linspace(0.0, 0.02, 11)
    tight = sj.simulate(scene, ts, rtol=1e-10)
    run = sj.simulate(scene, ts, rtol=1e-7, solver=diffrax.Kvaerno5())
    assert bool(run.succeeded)
    np.testing.assert_allclose(run.position("rocker"), tight.position("rocker"), atol=2e-8)
    assert int(run.stats.n_steps) < 4 * int(tight.stats.n_steps)
