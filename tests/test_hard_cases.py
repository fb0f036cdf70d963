"""Hard cases, value and gradient: each finishes, or stops with a status; no NaN in silence, no energy from nothing.

Here: a ball in a socket (dry contact, film, bushing). `test_hard_systems` has mechanisms, spin, long motion, lanes and
requests.
"""

from dataclasses import replace

import diffrax
import hard
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.physics.laws.material import generalized_stiffness


def _dry(n):
    steel = sj.Material(youngs_modulus=n["modulus"])
    return sj.Dry(
        clearance=n["clearance"],
        normal=sj.ExactRestitution(restitution=n["restitution"]),
        friction=sj.Threlfall(mu=n["mu"], v1=n["v1"]),
        socket_material=steel,
        ball_material=steel,
    )


DRY = hard.Family(_dry, (("clearance", 1e-4), ("restitution", 0.5), ("modulus", 207e9), ("mu", 0.1), ("v1", 1e-3)))
TOP = float(np.sqrt(2 * 9.81 * 1e-4))  # thrown up at this speed [m/s], the ball's highest point is the wall
BOTTOM_DEPTH = 5.5298e-8  # penetration at rest under the ball's weight [m]

DRY_CASES = {
    # The paper's start: no direction of contact, nothing to divide by; then fall, bounces and rest.
    "concentric start": (0.2, {}),
    # Stiff, hardly moving, and no step may end the contact by its error.
    "at rest for 10 s": (10.0, {}),
    # Started where it would come to rest: the onset has no speed, and hysteresis divides by that.
    "starts in static contact": (0.1, {"z": -1e-4 - BOTTOM_DEPTH}),
    # The same with the strongest damping.
    "starts in static contact, nearly plastic": (0.1, {"z": -1e-4 - BOTTOM_DEPTH, "restitution": 0.01}),
    # Far beyond the surface: 6 J of elastic energy that the damping must turn to heat.
    "starts deep in the wall": (0.01, {"z": -2e-4, "restitution": 0.01}),
    # The highest point of the flight lies on the wall, to rounding.
    "grazes the wall": (0.02, {"vz": TOP}),
    # Just short of the wall, and just enough to touch it at a millionth of the speed.
    "misses the wall by rounding": (0.02, {"vz": TOP * (1 - 1e-12)}),
    "touches the wall by rounding": (0.02, {"vz": TOP * (1 + 1e-12)}),
    # Bounces that follow each other ever faster, as many as there are digits: then rest, without a hang.
    "chatter": (2.0, {"clearance": 5e-3, "restitution": 0.9}),
    "long chatter": (10.0, {"clearance": 5e-3, "restitution": 0.99}),
    # All speed is lost in one long contact, with a damping of a hundred times the elastic force.
    "restitution 0.01": (0.2, {"restitution": 0.01}),
    # Nothing is lost: impacts for ever.
    "restitution 1": (0.5, {"restitution": 1.0, "mu": 0.0}),
    # Contact lasts longer than flight.
    "clearance 1 um": (0.2, {"clearance": 1e-6}),
    # Half the socket's radius.
    "clearance 5 mm": (1.0, {"clearance": 5e-3, "x": 4e-3}),
    # Ten times as stiff as steel.
    "modulus 2e12": (0.2, {"modulus": 2e12}),
    # A slope of friction of 1e5 per m/s, through each reversal of the swing in a wide socket.
    "stick-slip at v1 = 1e-6": (1.0, {"clearance": 5e-3, "x": 4.9e-3, "v1": 1e-6, "mu": 0.02}),
    # The lightest and the heaviest ball.
    "1 mg": (0.05, {"mass": 1e-6, "inertia": 1e-12}),
    "1 t": (0.1, {"mass": 1e3, "inertia": 1.0}),
    # The surface passes by at 100 m/s.
    "spin of 1e4 rad/s": (0.1, {"spin": 1e4}),
    # A thousand impacts on a line, without loss.
    "1000 impacts": (0.8, {"gravity": 0.0, "vx": 0.3, "restitution": 1.0, "mu": 0.0}),
    # A thousand impacts all around, with little friction and loss.
    "1000 impacts all around": (1.6, {"gravity": 0.0, "vx": 0.3, "vz": 0.05, "restitution": 0.999, "mu": 0.01}),
    # Impacts as fast as a bullet's.
    "100 m/s": (0.01, {"gravity": 0.0, "vx": 100.0, "restitution": 0.9}),
}


@pytest.mark.parametrize("name", DRY_CASES)
def test_dry_contact(name):
    t_end, changes = DRY_CASES[name]
    found = hard.run(DRY, t_end, **changes)
    hard.assert_sound(found)
    numbers = DRY.all_numbers(changes)
    if numbers["restitution"] == 1 and numbers["mu"] == 0:
        assert np.ptp(found.energy) <= hard.energy_bound(found, 1e-8)
    if name.startswith("1000 impacts"):
        assert found.n_onsets[0] > 1000


@pytest.mark.parametrize("name", ["concentric start", "at rest for 10 s", "starts in static contact", "chatter"])
def test_ball_comes_to_rest_at_the_depth_of_its_weight(name):
    t_end, changes = DRY_CASES[name]
    found = hard.run(DRY, t_end, **changes)
    numbers = DRY.all_numbers(changes)
    stiffness = generalized_stiffness(0.010, 0.010 - numbers["clearance"], sj.Material(), sj.Material())
    depth = (numbers["mass"] * numbers["gravity"] / float(stiffness)) ** (2 / 3)
    assert found.eccentricity[-1] - numbers["clearance"] == pytest.approx(depth, rel=1e-4)
    assert np.abs(found.velocity[-1]).max() < 1e-8


def test_stick_slip_reverses_and_ends():
    t_end, changes = DRY_CASES["stick-slip at v1 = 1e-6"]
    found = hard.run(DRY, t_end, **changes)
    reversals = np.sum(np.diff(np.sign(found.velocity[:, 0])) != 0)
    assert reversals >= 3
    assert found.energy[-1] < -0.5 * 0.2 * 9.81 * 5e-3  # below half its way to the bottom


# Time ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("t_start", "changes"),
    [
        (10.0, {"clearance": 1e-6, "vz": 1.0}),  # the landing window lasts 1e-14 s, time has steps of 2e-15 s
        (1e4, {"clearance": 1e-6, "vz": 1.0}),  # and here of 2e-12 s
        (1e6, {"vz": 1.0}),
        (-1e6, {"vz": 1.0}),
    ],
)
def test_rounding_of_time_near_a_contact(t_start, changes):
    found = hard.run(DRY, 0.05, t_start=t_start, **changes)
    hard.assert_sound(found)
    assert found.n_onsets[0] > 2
    assert found.n_accepted < 5000
    early = hard.run(DRY, 0.05, **changes)
    assert found.position[-1] == pytest.approx(early.position[-1], abs=1e-6 * DRY.all_numbers(changes)["clearance"])


def test_rounding_of_time_too_coarse_for_a_contact_is_diagnosed():
    found = hard.run(DRY, 0.05, t_start=1e9, vz=1.0)  # time has steps of 1e-7 s, as long as a hundredth of a contact
    assert found.status == sj.Status.STEP_TOO_SMALL
    hard.assert_sound_or_diagnosed(found)


def test_interval_of_no_length_is_the_start():
    found = hard.run(DRY, 0.0, vx=0.1)
    assert found.status == sj.Status.SUCCEEDED
    assert found.n_accepted == 0
    assert np.array_equal(found.ys, np.tile(found.ys[0], (hard.N_SAMPLES, 1)))
    slopes = hard.gradient(DRY, DRY_NUMBERS, 0.0, vx=0.1)
    assert np.isfinite(slopes).all()
    assert slopes[1, 0, DRY_NUMBERS.index("vx")] == pytest.approx(0.1)


def test_the_coarsest_tolerances_give_sound_runs_or_stop():
    """A step may then be wrong by a tenth of all; what the audit of contacts finds depends on rounding."""
    found = {rtol: hard.run(DRY, 0.2, rtol=rtol) for rtol in (0.08, 0.09, 0.1, 0.11, 0.12, 0.2)}
    stopped = {rtol for rtol, run in found.items() if run.status == sj.Status.AUDIT_FAILED}
    for rtol in found.keys() - stopped:
        hard.assert_sound(found[rtol], rtol)
        # The ball still trembles on the wall, by less than a thousandth of the clearance.
        assert found[rtol].eccentricity[-1] - 1e-4 == pytest.approx(BOTTOM_DEPTH, rel=1.0)
    assert len(stopped) <= 3


@pytest.mark.parametrize("rtol", [1e-3, 1e-14])
def test_tolerances_from_coarse_to_the_limit(rtol):
    found = hard.run(DRY, 0.2, rtol=rtol)
    hard.assert_sound(found, rtol)
    assert found.eccentricity[-1] - 1e-4 == pytest.approx(BOTTOM_DEPTH, rel=max(0.1, 10 * rtol))


@pytest.mark.parametrize(
    ("model", "floor"), [(sj.Ideal(), 5e-14), (sj.Bushing(1e6, 1e-4), 3e-13), (sj.Dry(1e-4), None)], ids=str
)
def test_a_tolerance_below_rounding_is_lifted_to_it_and_said(model, floor):
    """Steps that follow rounding are many, and gain nothing: 53,130 where 7,954 gave the same digits."""
    scene, ts = sj.gallery.four_bar(model), jnp.array([0.0, 0.02])
    at_limit, below = (sj.simulate(scene, ts, rtol=rtol) for rtol in (2e-14, 1e-14))
    assert int(at_limit.stats.n_steps) == int(below.stats.n_steps)
    assert "in place of 1e-14, which is below rounding" in below.stats.explanation
    if floor is not None:
        assert f"rtol {floor:.0e} in place" in below.stats.explanation
        assert "in place" not in sj.simulate(scene, ts, rtol=2 * floor).stats.explanation
    # Traced, and with tolerances of the user's own.
    traced = jax.jit(lambda rtol: sj.simulate(scene, ts, rtol=rtol).stats.n_steps)(1e-14)
    assert int(traced) == pytest.approx(int(below.stats.n_steps), rel=0.1)
    own = sj.simulate(scene, ts, rtol=1e-13, atol=1e-13)
    assert own.stats.explanation.count("tolerances as asked for") == 1


# Gradients ----------------------------------------------------------------------------------------------------------

DRY_NUMBERS = ["clearance", "restitution", "modulus", "mu", "v1", "gravity", "vx", "mass"]
SMOOTH = {
    # name: duration [s], changes, agreement with differences, step of the differences
    "free fall from the center": (3e-3, {"vx": 0.01}, 1e-8, 1e-6),
    "past the first impact": (6e-3, {"vx": 0.01}, 1e-4, 1e-6),
    "past the first impact, restitution 0.01": (6e-3, {"vx": 0.01, "restitution": 0.01}, 1e-3, 1e-6),
    "clearance 1 um": (4e-3, {"vx": 0.01, "clearance": 1e-6}, 1e-2, 1e-6),
    "clearance 5 mm": (0.1, {"vx": 0.01, "clearance": 5e-3, "x": 4e-3}, 1e-3, 1e-6),
    "modulus 2e12": (6e-3, {"vx": 0.01, "modulus": 2e12}, 1e-3, 1e-6),
    "stick-slip at v1 = 1e-6": (0.2, {"clearance": 5e-3, "x": 4.9e-3, "vx": 1e-3, "v1": 1e-6}, 1e-2, 1e-6),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_gradient_of_dry_contact_meets_differences(name):
    t_end, changes, agreement, step = SMOOTH[name]
    found = hard.gradient(DRY, DRY_NUMBERS, t_end, **changes)
    expected = hard.differences(DRY, DRY_NUMBERS, t_end, step=step, **changes)
    assert hard.disagreement(found, expected) < agreement


FINITE = [name for name in DRY_CASES if name not in ("long chatter", "at rest for 10 s", "1000 impacts all around")]


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "100 m/s")) for n in FINITE])
def test_gradient_of_dry_contact_is_finite(name):
    t_end, changes = DRY_CASES[name]
    assert np.isfinite(hard.gradient(DRY, DRY_NUMBERS, min(t_end, 0.2), rtol=1e-8, **changes)).all()


def test_gradient_at_rest_is_that_of_the_resting_place():
    # z = -(c + delta), delta = (m g / K)^(2/3): by c (through K as well), m and g.
    found = hard.gradient(DRY, DRY_NUMBERS, 0.2)[0, 2]
    c, depth = 1e-4, BOTTOM_DEPTH
    by_clearance = -(c + depth * (1 / 3) * (c / (0.010 - c) + 1))  # K ~ sqrt(R (R - c) / c)
    for name, expected in (("clearance", by_clearance), ("gravity", -depth * 2 / 3), ("mass", -depth * 2 / 3)):
        assert found[DRY_NUMBERS.index(name)] == pytest.approx(expected, abs=0.05 * depth), name


# Film ---------------------------------------------------------------------------------------------------------------


def _film(n):
    return sj.Lubricated(clearance=n["clearance"], viscosity=n["viscosity"], e_h0=n["e_h0"], e_h1=n["e_h1"])


FILM = hard.Family(_film, (("clearance", 1e-4), ("viscosity", 0.4), ("e_h0", 1e-6), ("e_h1", 2e-6)), max_steps=100_000)
THIN = {"e_h0": 1e-10, "e_h1": 1e-10}  # at the wall eps = 1 - 1e-6
FILM_CASES = {
    **{f"viscosity {nu}": (1.0, {"viscosity": nu}) for nu in (1e-3, 1e-2, 0.4, 10.0)},
    # Sinks under its weight through eps = 0.999999 to the wall, the transition switched off.
    "film alone to the wall": (1.0, {"viscosity": 1e-3, "e_h0": 0.0, "e_h1": 0.0}),
    # Through e = c into contact, and back.
    "into the wall and back": (0.05, {"vx": 2.0, "viscosity": 1e-3}),
    "into the wall and back, thin transition": (0.05, {"vx": 2.0, "viscosity": 1e-3, **THIN}),
    # Pressed out of contact through e = c.
    "out of the wall": (0.05, {"x": 1.02e-4, "vx": -0.01}),
    "starts at e = c": (0.05, {"x": 1e-4, "vx": -0.01}),
    # Brought to a halt from 50 m/s within the gap.
    "50 m/s": (0.05, {"vx": 50.0}),
    # The film damps at 4e11 per second there.
    "leaves from eps = 0.999999": (0.01, {"x": 0.999999e-4, "vx": -0.01, "e_h0": 0.0, "e_h1": 0.0}),
}


@pytest.mark.parametrize("name", FILM_CASES)
def test_film(name):
    t_end, changes = FILM_CASES[name]
    hard.assert_sound(hard.run(FILM, t_end, **changes))


def test_film_pressed_on_from_the_wall_finishes_or_is_diagnosed():
    # No transition, and the rate of closing hovers around zero, where the film switches halves.
    found = hard.run(FILM, 0.05, x=0.999999e-4, vx=0.01, e_h0=0.0, e_h1=0.0)
    hard.assert_sound_or_diagnosed(found)
    assert found.t_reached > 1e-5


FILM_SMOOTH = {
    # Viscosity 10 is not here: its rate, 1e7 per second, makes differences of tight runs rounding; it is among the
    # finite ones below.
    "from the center": (0.05, {"vx": 1e-3}),
    "viscosity 1e-3": (2e-3, {"vx": 1e-3, "viscosity": 1e-3}),
}

# Sensitivities by all numbers, the place and the velocity in every direction among them, need many more steps than the
# motion, and those of a film at its center and at its wall most: up to 750,000 at this tolerance.
FILM_GRADIENT = hard.Family(_film, FILM.numbers, max_steps=1_000_000)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FILM_SMOOTH, *FILM_CASES])
def test_gradient_of_a_film(name):
    names = ["clearance", "viscosity", "mass", "gravity", "vx"]
    if name in FILM_CASES:
        t_end, changes = FILM_CASES[name]
        assert np.isfinite(hard.gradient(FILM_GRADIENT, names, t_end, rtol=1e-6, **changes)).all()
        return
    t_end, changes = FILM_SMOOTH[name]
    found = hard.gradient(FILM_GRADIENT, names, t_end, rtol=1e-7, **changes)
    expected = hard.differences(FILM, names, t_end, **changes)
    assert hard.disagreement(found, expected) < 1e-5


# Bushing ------------------------------------------------------------------------------------------------------------


def _bushing(n):
    return sj.Bushing(stiffness=n["stiffness"], damping=n["damping"])


BUSHING = hard.Family(_bushing, (("stiffness", 1e6), ("damping", 1e-3)), max_steps=100_000)
STIFF_BUSHING = hard.Family(_bushing, BUSHING.numbers, max_steps=100_000, solver=sj.solvers.Rodas5P())
BUSHING_CASES = {
    # Every speed of relaxation, from 1e-4 to 5e10 per second.
    **{
        f"k = {k:.0e}, b = {b:.0e}": (0.02, {"stiffness": k, "damping": b, "vx": 0.1})
        for k in (1e2, 1e4, 1e6, 1e8, 1e10)
        for b in (0.0, 1e-6, 1e-3, 1.0)
    },
    # On a line through e = 0, again and again.
    "through e = 0": (0.05, {"vz": 0.1, "gravity": 0.0, "damping": 1e-5}),
    # Concentric and at rest: nothing moves.
    "at e = 0": (0.05, {"gravity": 0.0}),
    "1 mg": (0.05, {"mass": 1e-6, "inertia": 1e-12}),
    "1 t": (0.05, {"mass": 1e3, "inertia": 1.0}),
}


@pytest.mark.parametrize("name", BUSHING_CASES)
def test_bushing(name):
    t_end, changes = BUSHING_CASES[name]
    hard.assert_sound(hard.run(STIFF_BUSHING, t_end, **changes))
    # Without a look at the numbers (they are traced here) the automatic choice may be an explicit method.
    hard.assert_sound_or_diagnosed(hard.run(BUSHING, t_end, **changes))


def circling():
    """A ball that circles a nanometer off the center of a bushing that resists along the radius alone."""
    return BUSHING.all_numbers({"stiffness": 1e10, "damping": 1.0, "vx": 0.1, "vz": 0.1, "x": 1e-9, "spin": 1.0})


def test_automatic_choice_sees_a_stiff_bushing():
    """A hundred turns of the ball are more than may be followed, which is said; they are not passed over."""
    family = replace(BUSHING, max_steps=1000)
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        found = family.simulate(circling(), hard.times(0.02), 1e-8)
    assert "Rodas5P" in found.choice
    assert found.t_reached < 1e-5


@pytest.mark.parametrize(
    "options",
    [{}, {"adjoint": diffrax.RecursiveCheckpointAdjoint()}, {"solver": diffrax.Kvaerno5()}],
    ids=["lanes", "adjoint", "kvaerno"],
)
def test_no_first_step_damps_what_lasts(options):
    """diffrax alone begins with 0.01 s, and an L-stable method ends such a step at rest."""
    scene = BUSHING.scene(circling())
    ts = jnp.linspace(0.0, 0.02, 3)
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        run = sj.simulate(
            scene, ts, rtol=1e-8, atol=1e-11, **({"solver": sj.solvers.Rodas5P(), "max_steps": 40} | options)
        )
    assert 0 < run.t_reached < 1e-7
    speed = np.linalg.norm(run.y_reached[7:10])
    assert 0.05 < speed < 0.15


@pytest.mark.parametrize("name", ["through e = 0", "at e = 0", "k = 1e+02, b = 1e+00", "k = 1e+06, b = 0e+00"])
def test_gradient_of_a_bushing_meets_differences(name):
    t_end, changes = BUSHING_CASES[name]
    names = ["stiffness", "damping", "mass", "vx", "vz", "gravity"]
    found = hard.gradient(BUSHING, names, t_end, **changes)
    assert np.isfinite(found).all()
    assert hard.disagreement(found, hard.differences(BUSHING, names, t_end, **changes)) < 1e-4
