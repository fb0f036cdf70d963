"""Normal contact laws: their factors, their guards, and free impacts integrated independently."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from spherejax.foundations.checks import enforce
from spherejax.foundations.errors import SceneError
from spherejax.physics.functions.shapes import PowerTail
from spherejax.physics.laws import normal
from spherejax.physics.laws.impact import (
    exact_hysteresis_factor,
    maximum_penetration,
    realized_restitution,
)
from spherejax.physics.laws.material import Material, generalized_stiffness
from spherejax.physics.laws.normal import (
    BY_FACTOR,
    MINIMUM_ONSET_RATE,
    AbstractHysteresisLaw,
    ExactRestitution,
    Flores,
    Gonthier,
    Hertz,
    HuntCrossley,
    LankaraniNikravesh,
    by_factor,
)

FORMULAS = {
    HuntCrossley: lambda c: 3 * (1 - c) / 2,
    LankaraniNikravesh: lambda c: 3 * (1 - c**2) / 4,
    Gonthier: lambda c: (1 - c**2) / c,
    Flores: lambda c: 8 * (1 - c) / (5 * c),
}
LAWS = [*FORMULAS, ExactRestitution]
K = 1.508882e11  # N/m**1.5, the paper's clearance of 0.1 mm
FORCE = K * 2.6e-5**1.5  # 20 kN, the scale of the comparisons


def impact(chi, exponent):
    """A free impact of unit mass, stiffness and speed: restitution and largest penetration, by DOP853.

    Scaling delta by (m v**2/K)**(1/(n+1)) removes all three from the equation.
    """

    def rates(t, y):
        return [y[1], -(max(y[0], 0.0) ** exponent) * (1 + chi * y[1])]

    def separation(t, y):
        return y[0] if t > 0 else 1.0

    def turning(t, y):
        return y[1]

    separation.terminal, separation.direction = True, -1
    turning.direction = -1
    run = solve_ivp(
        rates,
        (0, 1e3),
        [0.0, 1.0],
        "DOP853",
        rtol=1e-12,
        atol=1e-14,
        events=[separation, turning],
        max_step=0.2,
    )
    return -run.y_events[0][0][1], run.y_events[1][0][0]


@pytest.mark.parametrize("exponent", [1.5, 2.0])
@pytest.mark.parametrize("c_r", [0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("law", LAWS)
def test_free_impact(law, c_r, exponent):
    chi = float(law(c_r, exponent=exponent).hysteresis_factor())
    restitution, penetration = impact(chi, exponent)
    np.testing.assert_allclose(restitution, realized_restitution(chi), rtol=1e-6)
    np.testing.assert_allclose(penetration, maximum_penetration(1.0, 1.0, chi, 1.0, exponent), rtol=1e-8)
    if law is ExactRestitution:
        np.testing.assert_allclose(restitution, c_r, rtol=1e-6)


def test_force_itself_realizes_the_restitution():
    law, mass, v, steps = ExactRestitution(0.7), 0.1, 0.05, 4000
    force = jax.jit(lambda d, r: law.force(d, r, v, K))
    duration = 4.0 * (mass**2 / (K**2 * v)) ** 0.2

    def rk4(y, h):
        def f(y):
            return jnp.array([y[1], -force(y[0], y[1]) / mass])

        k1 = f(y)
        k2 = f(y + h / 2 * k1)
        k3 = f(y + h / 2 * k2)
        return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(y + h * k3))

    y = jax.jit(lambda y: jax.lax.fori_loop(0, steps, lambda _, y: rk4(y, duration / steps), y))(jnp.array([0.0, v]))
    assert y[0] < 0  # has separated
    np.testing.assert_allclose(-y[1] / v, 0.7, rtol=1e-6)


@pytest.mark.parametrize("law", FORMULAS)
def test_published_factors(law):
    for c_r in (0.1, 0.5, 0.9, 1.0):
        np.testing.assert_allclose(law(c_r).hysteresis_factor(), FORMULAS[law](c_r), rtol=1e-14, atol=1e-16)


def test_quoted_limits():
    np.testing.assert_allclose(realized_restitution(0.75 * (1 - 0.1**2)), 0.665, atol=5e-4)
    np.testing.assert_allclose(realized_restitution(1.5), 0.488, atol=5e-4)
    small = 1e-6
    np.testing.assert_allclose(small * Gonthier(small).hysteresis_factor(), 1.0, rtol=1e-9)
    np.testing.assert_allclose(Gonthier(1 - small).hysteresis_factor(), 2 * small, rtol=1e-5)
    np.testing.assert_allclose(Flores(1 - small).hysteresis_factor(), 1.6 * small, rtol=1e-5)


def root_by_bracketing(e):
    """chi of the impact equation, solved without the Langevin function; u = 1 - chi e keeps the digits."""
    u = brentq(lambda u: (1 - u) / e * (1 + e) - np.log1p((1 - u) / e) + np.log(u), 1e-300, 1 - 0.2 * (1 - e))
    return (1 - u) / e


@pytest.mark.parametrize("e", [1e-2, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_exact_factor_solves_the_impact_equation(e):
    chi = float(exact_hysteresis_factor(e))
    np.testing.assert_allclose(chi, root_by_bracketing(e), rtol=1e-11)
    np.testing.assert_allclose(realized_restitution(chi), e, rtol=1e-13)


@pytest.mark.parametrize("e", [1e-50, 1e-6, 1e-3, 0.02, 0.2, 0.41, 0.53, 0.8, 0.999, 0.9999999])
def test_exact_factor_round_trip_and_derivatives(e):
    chi = exact_hysteresis_factor(e)
    np.testing.assert_allclose(realized_restitution(float(chi)), e, rtol=1e-13)
    forward = jax.jvp(exact_hysteresis_factor, (e,), (1.0,))[1]
    np.testing.assert_allclose(jax.grad(exact_hysteresis_factor)(e), forward, rtol=1e-13)
    step = 1e-5 * e
    differences = (exact_hysteresis_factor(e + step) - exact_hysteresis_factor(e - step)) / (2 * step)
    np.testing.assert_allclose(forward, differences, rtol=1e-8)


def test_exact_factor_limits():
    assert exact_hysteresis_factor(1.0) == 0.0
    np.testing.assert_allclose(jax.grad(exact_hysteresis_factor)(1.0), -1.5, rtol=1e-13)
    np.testing.assert_allclose(jax.grad(jax.grad(exact_hysteresis_factor))(1.0), 3.0, rtol=1e-12)
    np.testing.assert_allclose(exact_hysteresis_factor(1e-3), 1e3, rtol=1e-13)


def test_realized_restitution_limits():
    assert realized_restitution(0.0) == 1.0
    np.testing.assert_allclose(realized_restitution(1e-7), 1 - 2e-7 / 3, rtol=1e-13)
    np.testing.assert_allclose(realized_restitution(1e3), 1e-3, rtol=1e-13)
    for chi in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="hysteresis factor"):
            realized_restitution(chi)


def test_maximum_penetration_series_joins_and_is_elastic_at_zero():
    np.testing.assert_allclose(K * maximum_penetration(0.1, 0.05, 0.0, K) ** 2.5 / 2.5, 0.1 * 0.05**2 / 2, rtol=1e-13)

    def absorbed(chi):
        return maximum_penetration(0.4, 1.0, chi, 1.0) ** 2.5

    chi = np.geomspace(1e-3, 0.2, 50)
    long = chi.astype(np.longdouble)
    exact = ((long - np.log1p(long)) / long**2).astype(float)
    np.testing.assert_allclose(jax.vmap(absorbed)(chi), exact, rtol=5e-14)
    np.testing.assert_allclose(jax.grad(absorbed)(0.0), -1 / 3, rtol=1e-13)


@pytest.mark.parametrize("law", [Hertz(), *(law(0.9) for law in LAWS)], ids=lambda law: type(law).__name__)
@pytest.mark.parametrize(
    ("penetration", "penetration_rate", "onset_rate"),
    [
        (0.0, 0.1, 0.1),
        (-1e-5, 0.1, 0.1),
        (1e-5, 0.05, 0.1),
        (1e-5, 0.05, 0.0),
        (1e-9, 0.0, 0.1),
        (1e-5, -9.0, 0.1),
    ],
)
def test_force_is_finite_and_its_derivatives_agree(law, penetration, penetration_rate, onset_rate):
    x = jnp.array([penetration, penetration_rate, onset_rate])
    x = x + 1e-3 * jnp.array([0, 0, MINIMUM_ONSET_RATE])  # off the tie, where two derivatives exist
    units = jnp.array([1e-5, 0.1, max(onset_rate, MINIMUM_ONSET_RATE)])

    def force(u):
        return law.force(*(x + u * units), K)

    value = force(jnp.zeros(3))
    assert np.isfinite(value)
    assert value >= 0
    forward, reverse = jax.jacfwd(force)(jnp.zeros(3)), jax.jacrev(force)(jnp.zeros(3))
    step = 1e-5 if penetration > 1e-6 else 1e-8
    differences = [(force(h) - force(-h)) / (2 * step) for h in step * np.eye(3)]
    scale = max(float(np.abs(forward).max()), FORCE)
    np.testing.assert_allclose(forward, reverse, atol=1e-13 * scale)
    np.testing.assert_allclose(forward, differences, atol=1e-4 * scale)
    if penetration <= 0:
        assert value == 0
        np.testing.assert_array_equal(forward, 0.0)


def test_force_clips_and_guards_grazing():
    law = Flores(0.5)
    chi = float(law.hysteresis_factor())
    np.testing.assert_allclose(law.force(2.6e-5, 0.02, 0.1, K), FORCE * (1 + chi * 0.2), rtol=1e-13)
    assert law.force(2.6e-5, -0.1, 0.1, K) == 0.0  # pulled apart: no adhesion
    np.testing.assert_array_equal(jax.grad(law.force, (0, 1, 2))(2.6e-5, -0.1, 0.1, K), 0.0)
    np.testing.assert_allclose(
        law.force(2.6e-5, 1e-7, 0.0, K), FORCE * (1 + chi * 1e-7 / MINIMUM_ONSET_RATE), rtol=1e-13
    )


def test_elastic_energy_is_the_integral_of_the_elastic_force():
    for law in (Hertz(), Hertz(exponent=1.2), Flores(0.5, exponent=2.0)):
        for penetration in (-1e-5, 0.0, 2.6e-5):
            np.testing.assert_allclose(
                jax.grad(law.elastic_energy)(penetration, K), law.elastic_force(penetration, K), rtol=1e-13
            )
    np.testing.assert_allclose(Hertz().elastic_force(2.6e-5, 1.5089e11), 20e3, rtol=2e-3)


def test_hertz_leaves_no_trace_of_rates():
    jaxpr = jax.make_jaxpr(Hertz().force)(1e-5, 0.1, 0.1, K).jaxpr
    used = {id(v) for equation in jaxpr.eqns for v in equation.invars}
    assert id(jaxpr.invars[0]) in used
    assert id(jaxpr.invars[1]) not in used
    assert id(jaxpr.invars[2]) not in used
    assert Hertz().hysteresis_factor() == 0.0
    assert not Hertz.remembers_onset
    assert all(law.remembers_onset for law in LAWS)


def test_every_number_is_a_leaf_and_differentiable():
    law = LankaraniNikravesh(0.9, stiffness=K)
    assert len(jax.tree.leaves(law)) == 3
    gradient = jax.grad(lambda law: law.force(1e-5, 0.05, 0.1, law.stiffness))(law)
    np.testing.assert_allclose(gradient.restitution, -K * 1e-5**1.5 * 1.5 * 0.9 * 0.5, rtol=1e-13)
    np.testing.assert_allclose(gradient.exponent, law.force(1e-5, 0.05, 0.1, K) * np.log(1e-5), rtol=1e-13)


def test_requirements():
    for law in (Hertz(), Hertz(K), Flores(1.0), ExactRestitution(0.1, K, 1.0)):
        assert enforce("here", law.requirements()) == []
    for c_r in (0.0, -0.1, 1.01, np.nan):
        for law in LAWS:
            with pytest.raises(SceneError, match=r"restitution.*lie in"):
                enforce("here", law(c_r).requirements())
    for law, field in (
        (Hertz(0.0), "stiffness"),
        (Hertz(np.inf), "stiffness"),
        (Hertz(exponent=0.9), "exponent"),
        (Hertz(exponent=np.nan), "exponent"),
        (Material(0.0), "youngs_modulus"),
        (Material(poissons_ratio=0.6), "poissons_ratio"),
        (Material(poissons_ratio=-1.0), "poissons_ratio"),
    ):
        with pytest.raises(SceneError, match=field):
            enforce("here", law.requirements())
    assert enforce("here", Material().requirements()) == []


def test_requirements_under_tracing():
    @jax.jit
    def judged(c_r):
        with pytest.raises(SceneError):
            enforce("here", Flores(2.0).requirements())  # concrete inside jit
        with pytest.raises(SceneError):
            enforce("here", Flores(outside).requirements())
        flags = enforce("here", Flores(c_r).requirements())
        assert len(flags) == 1
        return flags[0]

    outside = jnp.asarray(2.0)
    assert judged(0.5)
    assert not judged(0.0)
    assert not judged(jnp.nan)


def test_a_law_of_your_own():
    class Linear(AbstractHysteresisLaw):
        restitution: float
        stiffness: float | None = None
        exponent: float = 1.0

        def hysteresis_factor(self):
            return 1.0 - self.restitution

    law = Linear(0.5)
    np.testing.assert_allclose(law.force(2.0, 0.1, 0.2, 10.0), 25.0, rtol=1e-14)
    assert isinstance(law, eqx.Module)


def test_generalized_stiffness():
    steel = Material()
    expected = {5e-5: 2.139263e11, 1e-4: 1.508882e11, 2e-4: 1.061538e11, 5e-4: 6.610198e10}
    for clearance, stiffness in expected.items():
        np.testing.assert_allclose(generalized_stiffness(0.01, 0.01 - clearance, steel, steel), stiffness, rtol=5e-7)
    soft = Material(youngs_modulus=2e9)
    by_hand = 4 / (3 * ((1 - 0.09) / 207e9 + (1 - 0.09) / 2e9)) * np.sqrt(0.01 * 0.0099 / 1e-4)
    np.testing.assert_allclose(generalized_stiffness(0.01, 0.0099, soft, steel), by_hand, rtol=1e-12)
    assert np.isfinite(jax.grad(lambda m: generalized_stiffness(0.01, 0.0099, m, steel))(steel).poissons_ratio)


# A law as its factor --------------------------------------------------------------------------------------------------


def test_every_law_of_impact_of_this_package_is_known_by_its_factor():
    own = {cls for cls in vars(normal).values() if isinstance(cls, type) and issubclass(cls, AbstractHysteresisLaw)}
    assert set(BY_FACTOR) == own - {AbstractHysteresisLaw}


@pytest.mark.parametrize("law", LAWS)
def test_the_factor_has_the_force_and_the_derivatives_of_the_law(law):
    rng = np.random.default_rng(3)
    points = np.stack([rng.uniform(-1e-6, 3e-5, 40), rng.normal(0, 0.1, 40), rng.choice([0.0, 1e-3, 0.2], 40)], 1)

    def force(restitution, change):
        made = change(law(restitution=restitution, exponent=1.5))
        return jax.vmap(lambda p: made.force(*p, K))(jnp.asarray(points))

    plain, factor = (jax.jit(lambda c, of=of: force(c, of)) for of in (lambda each: each, by_factor))
    assert type(by_factor(law(restitution=0.7))).__name__ == "_Factor"
    np.testing.assert_allclose(factor(0.7), plain(0.7), rtol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(factor)(0.7), jax.jacfwd(plain)(0.7), rtol=1e-12)
    known = by_factor(law(restitution=0.7))
    assert isinstance(known.factor, float)  # and no program has been made for it
    assert known.factor == pytest.approx(
        float(jax.jit(lambda c: law(restitution=c).hysteresis_factor())(0.7)), rel=1e-14
    )


class Sticking(HuntCrossley):
    """A user's own, with a force of its own."""

    def force(self, penetration, penetration_rate, onset_rate, stiffness):
        return 2.0 * super().force(penetration, penetration_rate, onset_rate, stiffness)


@pytest.mark.parametrize(
    "law", [Hertz(), Sticking(0.9), Flores(PowerTail(0.1, 0.25))], ids=["no factor", "a subclass", "by the onset"]
)
def test_other_laws_stay_what_they_are(law):
    assert by_factor(law) is law
