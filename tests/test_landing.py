"""Landing on contact onsets: where a step must end, what is remembered there, and several contacts in one scene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.solvers.crossing_search import crossing_fraction
from spherejax.motion.solvers.landing import LANDING_WINDOW

SPEED, CLEARANCE = 0.1, 1e-4


def _fraction(*values) -> float:
    return float(crossing_fraction(*(jnp.asarray(value) for value in values), LANDING_WINDOW))


@pytest.mark.parametrize("at", [0.3, 0.5, 0.123456789, 0.9])
def test_a_straight_crossing_is_found(at):
    # The first guess is exact: rounding must not throw it away.
    assert _fraction(-at, 1.0, 1 - at, 1.0) == pytest.approx(at, abs=LANDING_WINDOW)


def test_the_fraction_lands_behind_the_crossing_of_a_cubic():
    g = np.polynomial.Polynomial([-0.2, 0.1, 0.5, 0.4])
    slope = g.deriv()
    fraction = _fraction(g(0.0), slope(0.0), g(1.0), slope(1.0))
    assert 0 < g(fraction) < LANDING_WINDOW


def test_a_hump_inside_the_step_is_found():
    g = np.polynomial.Polynomial([-0.1, 1.0, -1.0])  # positive between 0.113 and 0.887
    slope = g.deriv()
    fraction = _fraction(g(0.0), slope(0.0), g(1.0), slope(1.0))
    assert fraction == pytest.approx(0.5 - np.sqrt(0.15), abs=1e-7)


@pytest.mark.parametrize(
    "values",
    [(-0.3, 0.1, -0.2, 0.1), (-0.3, 1.0, -0.3, -1.0), (-0.3, 1.0, LANDING_WINDOW / 2, 1.0)],
    ids=["rising below", "low hump", "landed"],
)
def test_no_landing_is_asked_for(values):
    assert _fraction(*values) == 1.0


def _scene(n_balls: int) -> sj.Scene:
    names = "ab"[:n_balls]
    return sj.Scene(
        {
            name: sj.Body(
                0.1, (1e-5, 1e-5, 1e-5), velocity=(SPEED * (i + 1), 0.0, 0.0), points={"center": (0.0, 0.0, 0.0)}
            )
            for i, name in enumerate(names)
        },
        {
            f"joint_{name}": sj.Spherical(
                "ground.socket", f"{name}.center", sj.Dry(CLEARANCE, friction=sj.Threlfall()), starts_concentric=False
            )
            for name in names
        },
        gravity=(0.0, 0.0, 0.0),
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


TIMES = jnp.linspace(0.0, 0.005, 51)


def test_the_onset_rate_is_the_speed_of_flight():
    run = sj.simulate(_scene(1), TIMES)
    remembered = np.asarray(run.state.memory)[:, 0]
    first = remembered[remembered > 0]
    assert run.stats.n_onsets.tolist() == [2]
    # Sampled in the first contact, if a sample falls there, and in the later ones, slower by the restitution.
    assert np.all(first <= SPEED * (1 + 1e-9))
    impact = sj.simulate(_scene(1), jnp.array([0.0, CLEARANCE / SPEED + 1e-6]))
    assert float(impact.state.memory[-1, 0]) == pytest.approx(SPEED, rel=1e-9)


def test_two_contacts_in_a_scene_do_not_disturb_each_other():
    both, alone = sj.simulate(_scene(2), TIMES), sj.simulate(_scene(1), TIMES)
    assert both.stats.n_onsets.tolist()[0] == alone.stats.n_onsets.tolist()[0]
    assert both.stats.n_onsets.tolist()[1] > both.stats.n_onsets.tolist()[0]
    difference = both.position("a") - alone.position("a")
    assert float(jnp.max(jnp.abs(difference))) < 1e-6 * CLEARANCE


@pytest.mark.filterwarnings("ignore::spherejax.errors.SerialRunsWarning")  # each run has times of its own
def test_no_step_is_so_long_that_its_stages_leave_the_contact():
    """Of a free impact the closed form is known. A first step of fifty times the contact's duration went through."""

    def restitution(chi, speed):
        center = {"center": (0.0, 0.0, 0.0)}
        model = sj.Dry(1e-4, normal=Damped(chi))
        scene = sj.Scene(
            {"ball": sj.Body(0.1, (1e-5, 1e-5, 1e-5), velocity=speed * jnp.array([1.0, 0.0, 0.0]), points=center)},
            {"joint": sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)},
            gravity=(0.0, 0.0, 0.0),
            ground_points={"socket": (0.0, 0.0, 0.0)},
        )
        run = sj.simulate(scene, jnp.array([0.0, 1.0]) * 2e-4 / speed, rtol=1e-9)
        return -run.velocity("ball")[-1, 0] / speed, run.status

    chis, speeds = np.repeat(np.geomspace(0.02, 60.0, 40), 3), np.tile([0.02, 0.1, 0.7], 40)
    found, status = jax.jit(jax.vmap(restitution))(jnp.asarray(chis), jnp.asarray(speeds))
    np.testing.assert_array_equal(status, 0)
    np.testing.assert_allclose(found, [sj.laws.realized_restitution(chi) for chi in chis], rtol=0, atol=2e-6)


class Damped(sj.laws.AbstractHysteresisLaw):
    """The law with a given chi."""

    chi: float
    restitution: float = 1.0
    stiffness: float | None = None
    exponent: float = 1.5

    def hysteresis_factor(self):
        return self.chi


def test_derivatives_through_impacts_take_less_than_twice_the_steps_of_the_motion():
    # With the end of a contact foreseen within the following step alone, and no limit to how long the last step of a
    # contact may be, it was 2.4 times.
    scene, ts = sj.gallery.four_bar(sj.Dry(CLEARANCE)), jnp.linspace(0.0, 0.1, 3)

    def end(clearance):
        model = sj.Dry(clearance)
        run = sj.simulate(sj.gallery.four_bar(model), ts)
        return run.position("rocker")[-1], run.stats

    plain = sj.simulate(scene, ts).stats
    (_, stats), (slope, _) = jax.jvp(end, (CLEARANCE,), (CLEARANCE,))
    assert int(stats.n_onsets[0]) == int(plain.n_onsets[0]) == 27
    assert int(stats.n_steps) < 1.95 * int(plain.n_steps)
    step = 1e-5
    ends = [sj.simulate(sj.gallery.four_bar(sj.Dry(CLEARANCE * (1 + h))), ts, rtol=1e-11) for h in (step, -step)]
    difference = (ends[0].position("rocker")[-1] - ends[1].position("rocker")[-1]) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-4 * float(jnp.max(jnp.abs(difference))))
