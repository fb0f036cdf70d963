"""Limits: every model tends to the simpler one that it contains, at the order that it should."""

import cases
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

T = 0.1
OPTIONS = {"rtol": 1e-9, "atol": 1e-12}


def final(scene, solver=None):
    """Positions of all bodies at T [m]."""
    run = sj.simulate(scene, cases.times(T), solver=solver, **OPTIONS).require_success()
    return np.stack([np.asarray(run.position(name))[-1] for name in run.system.bodies])


def distances(build, values, limit, solver=None):
    return np.array([np.abs(final(sj.gallery.four_bar(build(v)), solver) - limit).max() for v in values])


def orders(errors, values):
    """Observed orders between neighbors."""
    return np.diff(np.log(errors)) / np.diff(np.log(values))


@pytest.fixture(scope="module")
def ideal():
    return final(sj.gallery.four_bar())


def test_clearance_to_zero_is_the_ideal_joint(ideal):
    clearances = np.array([1e-4, 1e-5, 1e-6])
    errors = distances(lambda c: sj.Dry(clearance=c), clearances, ideal)
    # The ball is somewhere within the clearance: bounded by it, not smooth in it.
    assert (errors < 5 * clearances).all(), errors
    assert np.log10(errors[0] / errors[-1]) / 2 == pytest.approx(1.0, abs=0.4), errors


def test_bushing_stiffness_to_infinity_is_the_ideal_joint(ideal):
    stiffness = np.array([1e6, 1e7, 1e8])
    errors = distances(lambda k: sj.Bushing(stiffness=k, damping=1e-3), stiffness, ideal, sj.solvers.Rodas5P())
    assert orders(errors, 1 / stiffness) == pytest.approx([1.0, 1.0], abs=0.1), errors


@pytest.mark.slow
def test_viscosity_to_infinity_is_the_ideal_joint(ideal):
    viscosity = np.array([4.0, 40.0, 400.0])
    film = sj.laws.RadialFilm()  # the full film's shear would grow with the viscosity
    errors = distances(
        lambda nu: sj.Lubricated(cases.C, viscosity=nu, film=film), viscosity, ideal, sj.solvers.Rodas5P()
    )
    assert orders(errors, 1 / viscosity) == pytest.approx([1.0, 1.0], abs=0.1), errors


def test_friction_to_zero_is_the_frictionless_joint():
    frictionless = final(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"]))
    mu = np.array([1e-5, 1e-6, 1e-7])
    errors = distances(lambda m: sj.Dry(clearance=cases.C, friction=sj.Threlfall(mu=m, v1=1e-3)), mu, frictionless)
    assert errors[0] > 0
    assert orders(errors, mu) == pytest.approx([1.0, 1.0], abs=0.2), errors


@pytest.mark.slow
def test_blend_widths_to_zero_are_the_unblended_film():
    def model(h):
        return sj.Lubricated(clearance=cases.C, viscosity=0.4, e_h0=h, e_h1=h)

    unblended = final(sj.gallery.four_bar(model(0.0)))
    widths = np.array([4e-6, 4e-7, 4e-8])
    errors = distances(model, widths, unblended)
    assert orders(errors, widths) == pytest.approx([1.0, 1.0], abs=0.1), errors


@pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning")  # pressed beyond what Eq. 24 is for
def test_restitution_to_one_is_hertz():
    # No friction, no loss: the same motion until the first impacts have amplified the difference.
    def run(normal):
        scene = cases.ball_in_socket(sj.Dry(clearance=cases.C, normal=normal), 0.2, (0.0, 0.3, 0.4))
        done = sj.simulate(scene, cases.times(5e-4), **OPTIONS).require_success()
        return np.asarray(done.position("ball"))[-1]

    hertz = run(sj.Hertz())
    losses = np.array([1e-3, 1e-4, 1e-5])
    errors = np.array([np.abs(run(sj.ExactRestitution(restitution=1 - x)) - hertz).max() for x in losses])
    assert orders(errors, losses) == pytest.approx([1.0, 1.0], abs=0.1), errors


def test_curve_with_one_point_is_the_vector_bushing():
    def run(law):
        scene = cases.ball_in_socket(sj.Bushing(law=law), 0.2, (0.3, 0.0, 0.4))
        done = sj.simulate(scene, cases.times(2e-3), **OPTIONS).require_success()
        return np.asarray(done.position("ball"))[-1]

    curve = run(sj.laws.CurveElastomer(np.array([1e-4]), np.array([100.0]), 1e-4))
    vector = run(sj.laws.VectorElastomer(1e6, 1e-4))
    assert jnp.abs(curve - vector).max() < 1e-10 * 1e-3
