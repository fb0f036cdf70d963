"""Surfaces that nearly fit: their loads against quadrature over the sphere and against mechanics in 40 digits."""

import math
from decimal import Decimal, getcontext

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import spherejax as sj
from spherejax.physics.laws.conformity import LARGEST_HERTZIAN_RATIO, Pair, PressedPair

STEEL = sj.Material()
LINER = sj.laws.WinklerLiner(youngs_modulus=0.8e9, poissons_ratio=0.46, thickness=5e-3)
PROFILE = sj.laws.SphericalProfile()
LAWS = {"profile": PROFILE, "liner": LINER}
beyond_eq_24 = pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning")
RATIOS = (1e-9, 1e-6, 1e-3, 0.01, 0.1, 0.5, 1.0, 3.0)


def pair(clearance, radius=0.010):
    return Pair(clearance, radius, 2 * STEEL.contact_compliance())


def profile_load(depth, surfaces):
    """Contact radius and load of the profile of spheres, by bisection in 40 digits."""
    getcontext().prec = 40
    c, outer, depth = (Decimal(float(x)) for x in (surfaces.clearance, surfaces.socket_radius, depth))
    inner = outer - c

    def span(radius, a):
        return ((radius + a) / (radius - a)).ln()

    low, high = Decimal(0), inner
    for _ in range(125):
        a = (low + high) / 2
        low, high = (a, high) if a * (span(inner, a) - span(outer, a)) / 2 < depth else (low, a)
    load = (a * a + inner**2) * span(inner, a) / 2 - (a * a + outer**2) * span(outer, a) / 2 - a * (inner - outer)
    return float(a), float(load / Decimal(float(surfaces.compliance)))


@pytest.mark.parametrize("clearance", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("ratio", RATIOS)
def test_the_profile_is_solved_to_rounding(clearance, ratio):
    surfaces = pair(clearance)
    radius, load = profile_load(ratio * clearance, surfaces)
    assert float(PROFILE.contact_radius(ratio * clearance, surfaces)) == pytest.approx(radius, rel=1e-14)
    # Ball and socket carry nearly equal and opposite terms: digits are lost as c/R.
    lost = 1e-15 * surfaces.socket_radius / clearance
    assert float(PROFILE.force(ratio * clearance, surfaces)) == pytest.approx(load, rel=5 * lost + 1e-13)


@pytest.mark.parametrize("ratio", [1e-3, 0.1, 1.0])
def test_the_liner_is_its_pressure_integrated_over_the_sphere(ratio):
    c, radius = 1e-4, 0.010
    depth = ratio * c

    def pressed(cosine):
        # Interpenetration e.u - c, its component along the line of centers, on rings of the sphere.
        return ((c + depth) * cosine - c) * cosine

    edge = c / (c + depth)
    by_hand = 2 * math.pi * radius**2 * float(LINER.foundation()) * quad(pressed, edge, 1.0, epsabs=0, epsrel=1e-13)[0]
    assert float(LINER.force(depth, pair(c))) == pytest.approx(by_hand, rel=1e-9)


def test_the_liner_has_the_confined_modulus_of_its_material():
    lame = 0.8e9 * 0.46 / (1.46 * 0.08)
    assert float(LINER.foundation()) == pytest.approx((lame + 0.8e9 / 1.46) / 5e-3, rel=1e-14)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_energy_is_the_integral_of_the_force_and_the_force_grows(name, ratio):
    law, surfaces = LAWS[name], pair(1e-4)
    depth = ratio * 1e-4
    force = float(law.force(depth, surfaces))
    assert float(jax.grad(lambda x: law.energy(x, surfaces))(depth)) == pytest.approx(force, rel=1e-9)
    slope = jax.grad(lambda x: law.force(x, surfaces))
    h = 1e-4 * depth
    differences = (law.force(depth + h, surfaces) - law.force(depth - h, surfaces)) / (2 * h)
    assert 0 < float(slope(depth)) == pytest.approx(float(differences), rel=1e-6)
    curvature = (slope(depth + h) - slope(depth - h)) / (2 * h)
    scale = float(slope(depth)) / depth
    assert float(jax.grad(slope)(depth)) == pytest.approx(float(curvature), rel=1e-5, abs=1e-6 * scale)
    reverse = jax.grad(lambda one: law.force(depth, one))(surfaces)
    for i, name in enumerate(Pair._fields):
        tangent = Pair(*(float(i == j) for j in range(3)))
        forward = jax.jvp(lambda one: law.force(depth, one), (surfaces,), (tangent,))[1]
        assert float(getattr(reverse, name)) == pytest.approx(float(forward), rel=1e-11)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("depth", [0.0, -1e-9, -1e-4])
def test_without_contact_there_is_neither_force_nor_derivative(name, depth):
    law, surfaces = LAWS[name], pair(1e-4)
    for function in (law.force, law.energy):
        value, slope = jax.value_and_grad(lambda x, function=function: function(x, surfaces))(depth)
        assert value == slope == 0.0
        others = jax.grad(lambda one, function=function: function(depth, one))(surfaces)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(others))


def test_the_profile_tends_to_hertz_and_parts_from_it_where_the_warning_begins():
    surfaces = pair(1e-4)
    stiffness = float(sj.laws.generalized_stiffness(0.010, 0.0099, STEEL, STEEL))

    def share(ratio):
        depth = ratio * 1e-4
        return float(PROFILE.force(depth, surfaces)) / (stiffness * depth**1.5)

    assert share(1e-6) == pytest.approx(1.0, abs=1e-6)
    assert share(LARGEST_HERTZIAN_RATIO) == pytest.approx(0.97, abs=5e-3)
    assert share(1.0) == pytest.approx(0.8, abs=5e-3)
    # 20 kN in a socket of 10 mm: Eq. 24 gives 26.0 um.
    assert float(PressedPair(PROFILE, surfaces).depth(20e3)) == pytest.approx(27.3e-6, abs=5e-8)
    assert (20e3 / stiffness) ** (2 / 3) == pytest.approx(26.0e-6, abs=5e-8)


@pytest.mark.parametrize("name", LAWS)
def test_depth_inverts_the_force(name):
    pressed = PressedPair(LAWS[name], pair(1e-4))
    for load in (1e-6, 1.0, 1e3, 1e6):
        assert float(pressed.force(pressed.depth(load))) == pytest.approx(load, rel=1e-10)


@pytest.mark.parametrize("name", LAWS)
def test_a_bouncing_ball_keeps_its_energy_and_returns_with_the_restitution_asked_for(name):
    """Whatever the elastic law: a hysteresis factor follows from the restitution alone."""
    exact = sj.ExactRestitution(restitution=0.6)
    scene = cases.ball_in_socket(sj.Dry(1e-4, normal=exact, conformity=cases.CONFORMITIES[name]), velocity=(0, 0, 0.2))
    # To the wall in 0.5 ms, back across by 1.9 ms.
    run = sj.simulate(scene, jnp.linspace(0, 1.5e-3, 4), rtol=1e-10, throw=True)
    assert int(run.stats.n_onsets[0]) == 1
    assert float(run.velocity("ball")[-1, 2]) == pytest.approx(-0.12, rel=1e-6)
    elastic = sj.simulate(
        cases.ball_in_socket(
            sj.Dry(1e-4, normal=sj.Hertz(), conformity=cases.CONFORMITIES[name]), velocity=(0, 0, 0.2)
        ),
        jnp.linspace(0, 5e-3, 101),
        rtol=1e-10,
        throw=True,
    )
    energy = np.asarray(elastic.mechanical_energy)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)


def test_bad_conformity_is_refused_before_anything_is_computed():
    def refused(model, words):
        with pytest.raises(sj.SceneError, match=words):
            sj.simulate(sj.gallery.four_bar(model), jnp.linspace(0, 0.1, 3))

    refused(
        sj.Dry(1e-4, conformity=sj.laws.WinklerLiner(1e9, 0.5, 1e-3)), r"WinklerLiner\.poissons_ratio.*incompressible"
    )
    refused(sj.Dry(1e-4, conformity=sj.laws.WinklerLiner(1e9, 0.4, 0.0)), r"WinklerLiner\.thickness")
    stiff = sj.Flores(0.9, stiffness=1e11)
    refused(sj.Dry(1e-4, normal=stiff, conformity=PROFILE), "stiffness.*not be given beside a SphericalProfile")
    refused(sj.Dry(1e-4, normal=sj.Hertz(exponent=1.2)), r"exponent = 1.2 must be 1.5 without a stiffness")


def test_models_with_conformity_go_through_files(tmp_path):
    for name, law in cases.CONFORMITIES.items():
        scene = sj.gallery.four_bar(sj.Lubricated(1e-4, conformity=law))
        path = tmp_path / f"{name}.toml"
        sj.save_scene(scene, path)
        again = sj.load_scene(path)
        assert jax.tree.structure(again) == jax.tree.structure(scene)
        assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(scene), strict=True))
    assert 'thickness = "2 mm"' in path.read_text() or "thickness = 0.002" in path.read_text()


# Without memory, and a restitution that depends on the speed ---------------------------------------------------------


def held(normal, load=20e3, ramp=0.05):
    """A ball of 0.2 kg that lies on the wall of its lubricated socket and is loaded along it in `ramp` seconds."""
    ball = sj.Body(0.2, (1e-5,) * 3, position=(0.0, 0.0, -1e-4), points={"center": (0.0, 0.0, 0.0)})
    push = sj.AppliedWrench("ball", force=lambda t: jnp.stack([0.0 * t, 0.0 * t, -load * jnp.minimum(t / ramp, 1.0)]))
    joint = sj.Spherical("ground.socket", "ball.center", sj.Lubricated(1e-4, normal=normal), starts_concentric=False)
    return sj.Scene(
        {"ball": ball}, {"joint": joint}, {"push": push}, gravity=(0, 0, 0), ground_points={"socket": (0.0, 0.0, 0.0)}
    )


@beyond_eq_24
@pytest.mark.slow
def test_a_held_contact_is_pressed_in_as_far_as_its_load_presses_it():
    ts = jnp.array([0.0, 0.05, 0.1])
    run = sj.simulate(held(None), ts, throw=True)
    assert isinstance(run.system.spherical("joint").model.normal, sj.laws.HuntCrossleyDissipation)
    assert float(run.part("joint", "penetration")[-1]) == pytest.approx(26.0e-6, rel=1e-2)
    # By the onset's rate it creeps for seconds: what the memory-free law is for.
    slow = sj.simulate(held(sj.LankaraniNikravesh(0.9)), ts, throw=True)
    assert float(slow.part("joint", "penetration")[-1]) < 20e-6


@beyond_eq_24
def test_dissipation_restores_less_of_faster_impacts():
    def restored(speed, alpha=0.5):
        law = sj.laws.HuntCrossleyDissipation(dissipation=alpha)
        scene = cases.ball_in_socket(sj.Dry(1e-4, normal=law), velocity=(0.0, 0.0, speed))
        run = sj.simulate(scene, jnp.array([0.0, 1.9 * 1e-4 / speed]), rtol=1e-10, throw=True)
        return -float(run.velocity("ball")[-1, 2]) / speed

    assert restored(1e-3) == pytest.approx(1 - 0.5e-3, abs=1e-6)
    # Without memory the closed form holds with chi = 1.5 alpha v.
    for speed in (0.1, 1.0):
        assert restored(speed) == pytest.approx(sj.laws.realized_restitution(1.5 * 0.5 * speed), rel=1e-6)
    assert restored(0.1, alpha=0.0) == pytest.approx(1.0, abs=1e-7)


@beyond_eq_24
def test_metals_that_yield_restore_less_of_faster_impacts():
    law = sj.ExactRestitution(restitution=sj.functions.PowerTail(0.9, 0.05))
    for speed, expected in ((0.02, 0.9), (0.05, 0.9), (0.8, 0.45)):
        assert float(law.at_onset(speed).restitution) == pytest.approx(expected, rel=1e-14)
        scene = cases.ball_in_socket(sj.Dry(1e-4, normal=law), velocity=(0.0, 0.0, speed))
        run = sj.simulate(scene, jnp.array([0.0, 1.6 * 1e-4 / speed]), rtol=1e-10, throw=True)
        assert float(run.velocity("ball")[-1, 2]) == pytest.approx(-expected * speed, rel=1e-5)
    by_python = sj.ExactRestitution(restitution=lambda v: 0.9 * jnp.maximum(v / 0.05, 1.0) ** -0.25)
    assert float(by_python.at_onset(0.8).restitution) == pytest.approx(0.45, rel=1e-14)


def test_a_restitution_must_lie_between_zero_and_one_at_any_speed():
    with pytest.raises(sj.SceneError, match=r"restitution = 1\.2 must lie in \(0, 1\] at any speed"):
        sj.simulate(
            sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Flores(lambda v: 1.2 - 0.0 * v))), jnp.linspace(0, 0.1, 3)
        )
    with pytest.raises(sj.SceneError, match=r"restitution\.start"):
        sj.simulate(
            sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Flores(sj.functions.PowerTail(0.9, -1.0)))),
            jnp.linspace(0, 1, 3),
        )

    def scene(value):
        return sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Flores(sj.functions.PowerTail(value, 0.05))))

    ended = jax.jit(lambda value: sj.simulate(scene(value), jnp.linspace(0, 1e-3, 2)).status)
    assert int(ended(0.9)) == sj.Status.SUCCEEDED
    assert int(ended(1.1)) == sj.Status.BAD_VALUE


def test_a_yielding_restitution_stands_in_files(tmp_path):
    scene = sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Gonthier(restitution=sj.functions.PowerTail(0.9, 0.05))))
    sj.save_scene(scene, tmp_path / "yield.toml")
    text = (tmp_path / "yield.toml").read_text()
    assert 'kind = "power-tail"' in text
    again = sj.load_scene(tmp_path / "yield.toml")
    assert jax.tree.structure(again) == jax.tree.structure(scene)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(scene), strict=True))
