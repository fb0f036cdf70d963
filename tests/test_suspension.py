"""The paper's suspension: check values, links with and without mass, and what each joint model does over the bump.

Check values: two public models of the benchmark's suspension, which agree with each other and with the paper's Table 6
and Eqs 42 and 43.
"""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

JOINT = "wheel_a_arm"
MODELS = {
    "ideal": sj.Ideal(),
    "dry": sj.Dry(1e-4),
    "friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "lubricated": sj.Lubricated(1e-4, viscosity=0.4),
    "bushing": sj.Bushing(2e7, 1e-3),
}
STIFF = ("friction", "lubricated")
"""Run at 1e-6, where the choice is Ros34PW2, which compiles in a quarter of the time of Rodas5P."""

TS = jnp.linspace(0.0, 6.0, 6001)


@functools.lru_cache
def run_of(name: str, link_mass: float | None = None) -> sj.Trajectory:
    rtol = 1e-6 if name in STIFF else 1e-8
    return sj.simulate(sj.gallery.suspension(MODELS[name], link_mass=link_mass), TS, rtol=rtol, throw=True)


def size(vectors) -> np.ndarray:
    return np.linalg.norm(np.asarray(vectors), axis=1)


def at(t: float) -> int:
    return round(1e3 * t)


def test_the_start_closes_to_rounding():
    run = run_of("ideal")
    assert run.assembly.residual_before < 1e-12
    assert np.max(run.constraint_violation) < 1e-9


def test_rest_before_the_bump():
    run, i = run_of("ideal"), at(2.9)
    assert run.position("wheel")[i, 2] == pytest.approx(0.355937, abs=5e-7)
    assert run.force("tyre")["load"][i] == pytest.approx(3363.8, abs=0.05)
    assert run.force("leaf")["force"][i] == pytest.approx(2726.2, abs=0.05)
    assert run.force("shock")["length"][i] == pytest.approx(0.440594, abs=5e-7)
    assert size(run.reaction(JOINT))[i] == pytest.approx(1242, abs=0.5)
    assert size(run.velocity("wheel"))[i] < 1e-6


def test_over_the_bump():
    run = run_of("ideal")
    z, force, load = run.position("wheel")[:, 2], run.reaction(JOINT), run.force("tyre")["load"]
    assert 1e3 * (z.max() - z[at(2.9)]) == pytest.approx(146, abs=0.5)
    assert load.max() == pytest.approx(28.25e3, abs=5)
    largest = int(size(force).argmax())
    assert size(force)[largest] == pytest.approx(20.82e3, abs=5)
    assert TS[largest] == pytest.approx(3.479, abs=5e-4)
    assert abs(force[largest, 2]) == pytest.approx(19.9e3, abs=50)
    assert np.max(np.abs(z[at(4.2) :] - z[at(2.9)])) < 1e-4
    assert np.max(np.abs(z[at(4.0) :] - z[at(2.9)])) > 1e-4


def test_the_laws_of_the_shock_absorber_are_smooth():
    """Value and slope of Eq. 43 at its breaks, to the printed digits; Eq. 42 as printed."""
    from spherejax.gallery.suspension import SHOCK_DAMPER, SHOCK_SPRING

    for at_break in (-0.20, 0.21):
        below, above = (float(SHOCK_DAMPER(at_break + d)) for d in (-1e-9, 1e-9))
        assert above - below == pytest.approx(0.0, abs=0.1)
        slopes = [float(SHOCK_DAMPER.derivative(at_break + d)) for d in (-1e-9, 1e-9)]
        assert slopes[1] == pytest.approx(slopes[0], rel=1e-3)
    x = 0.440594
    expected = -4.0092e6 + 2.8397e7 * x - 6.7061e7 * x**2 + 5.2796e7 * x**3
    assert SHOCK_SPRING(x) == pytest.approx(expected, abs=1e-6)


def test_mass_of_the_links_is_without_influence():
    """The motion of massless links is the limit of light ones: a tenth of the mass, a tenth of the difference."""
    massless, light, heavier = (run_of("ideal", mass) for mass in (None, 1e-3, 1e-2))
    differences = [np.max(np.abs(massless.position("wheel") - one.position("wheel"))) for one in (light, heavier)]
    assert differences[1] < 1e-5  # of 146 mm
    assert differences[0] == pytest.approx(0.1 * differences[1], rel=0.05)
    assert "leaf_spring" not in massless.system.bodies
    assert "leaf_spring" in light.system.bodies


@pytest.mark.parametrize("name", ["dry", "friction", "lubricated"])
def test_clearance_is_pressed_in_by_the_load(name):
    """The paper: about 20 kN press 0.026 mm in, so |e| is 0.126 mm; K = 1.5089e11 N/m^1.5."""
    run = run_of(name)
    force, e = size(run.reaction(JOINT)), size(run.eccentricity(JOINT))
    settled = TS > 0.5
    assert force[settled].max() == pytest.approx(20.8e3, rel=2e-3)
    assert 1e3 * e[settled].max() == pytest.approx(0.1266, abs=2e-4)
    top = int(np.argmax(np.where(settled, e, 0.0)))
    expected = (force[top] / 1.5089e11) ** (2 / 3)
    assert e[top] - 1e-4 == pytest.approx(expected, rel=3e-3)
    assert np.all(e[settled] > 1e-4)


def test_the_film_cannot_carry_the_load():
    """In contact mode from 0.03 s on, for good; the film itself then carries nothing."""
    run = run_of("lubricated")
    e = size(run.eccentricity(JOINT))
    assert e[at(0.015)] < 1e-4
    assert np.all(e[at(0.03) :] > 1e-4)
    assert size(run.part(JOINT, "film_force"))[at(0.03) :].max() < 1.0


def test_the_bushing_yields_by_a_millimeter():
    e = size(run_of("bushing").eccentricity(JOINT))
    assert 1e3 * e.max() == pytest.approx(1.02, abs=0.01)


@pytest.mark.parametrize("name", ["dry", "friction", "lubricated", "bushing"])
def test_the_wheel_moves_as_with_an_ideal_joint(name):
    """No significant difference except in the joint itself: below half a percent of the travel."""
    ideal, run = run_of("ideal"), run_of(name)
    difference = np.abs(run.position("wheel")[:, 2] - ideal.position("wheel")[:, 2])[TS > 0.5]
    assert difference.max() < 0.005 * 0.146
    assert difference.max() > 1e-5  # they are different models
    assert run.force("tyre")["load"].max() == pytest.approx(28.25e3, rel=5e-3)


def test_the_automatic_choice_takes_few_steps():
    """Stability alone would hold an explicit method to 1e5 and 3e5 steps with friction and with a film."""
    for name, n_most in {
        "ideal": 600,
        "dry": 20_000,
        "friction": 10_000,
        "lubricated": 15_000,
        "bushing": 10_000,
    }.items():
        assert int(run_of(name).stats.n_steps) < n_most, name


def test_a_stiff_method_does_not_step_over_the_bump():
    """At rest the error of a long step is nothing, and the bump is over within one of them."""
    scene, ts = sj.gallery.suspension(), jnp.linspace(0.0, 6.0, 61)
    run = sj.simulate(scene, ts, rtol=1e-6, solver=sj.Ros34PW2(), throw=True)
    assert 1e3 * (run.position("wheel")[35, 2] - run.position("wheel")[29, 2]) == pytest.approx(146, abs=0.5)


def test_speed_is_a_number_that_can_be_traced():
    """Half the speed, half as early: at 2.5 m/s the bump begins at 6 s."""
    ts = jnp.array([0.0, 2.9, 3.5])
    slow = sj.simulate(sj.gallery.suspension(speed=2.5), ts, throw=True).position("wheel")[:, 2]
    assert slow[2] == pytest.approx(float(slow[1]), abs=1e-6)
