"""Runs audit themselves: what cannot be ends a run, in single runs and in lanes, and is said in words."""

import warnings
from typing import ClassVar

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.integration.audit import (
    CHECKS,
    LOST_IN_A_STEP,
    NOT_MADE,
    OUTSIDE,
    Limits,
    Vitals,
    cautions,
    findings,
    parts_with_a_range,
    suspects,
    texts_for,
)  # fmt: skip
from spherejax.motion.integration.status import Status
from spherejax.motion.results.run_flags import flagged_runs
from spherejax.motion.runs.many import simulate_many
from spherejax.motion.start.assembly import described_state

TIMES = jnp.linspace(0.0, 0.5, 6)


class Pump(sj.forces.AbstractForce):
    """Pushes a body along its velocity, and says that it never adds energy."""

    strength: float
    claims: ClassVar[bool] = True

    @property
    def never_adds_energy(self):
        return self.claims

    @property
    def body_names(self):
        return ("ball",)

    def wrenches(self, t, motions):
        return {"ball": sj.forces.Wrench(self.strength * motions["ball"].velocity, jnp.zeros(3))}


class HonestPump(Pump):
    """The same, and says nothing."""

    claims: ClassVar[bool] = False


def thrown(force) -> sj.Scene:
    ball = sj.Body(0.2, (1e-5, 1e-5, 1e-5), velocity=(0.3, 0.0, 0.4), points={"center": (0.0, 0.0, 0.0)})
    return sj.Scene({"ball": ball}, {}, forces={"pump": force})


def test_energy_from_nowhere_ends_the_run_with_its_name_and_time():
    with pytest.warns(sj.SimulationWarning, match="the energy rose by more than was put in"):
        run = sj.simulate(thrown(Pump(0.01)), TIMES)
    assert int(run.status) == Status.AUDIT_FAILED
    assert 0 < float(run.t_reached) < 0.5
    assert "run.audit" in run.diagnosis
    assert "energy rose" in run.audit
    assert np.isnan(run.position("ball")[-1]).all()
    with pytest.raises(sj.SimulationError, match="energy rose"):
        sj.simulate(thrown(Pump(0.01)), TIMES, throw=True)


def test_in_lanes_and_under_jit_the_same_runs_fail_and_the_others_do_not():
    strengths = jnp.array([0.0, 0.01, -0.01])
    runs = simulate_many(lambda strength: thrown(Pump(strength)), {"strength": strengths}, TIMES).trajectories
    expected = [Status.SUCCEEDED, Status.AUDIT_FAILED, Status.SUCCEEDED]
    assert runs.status.tolist() == expected
    assert "lane 1: stopped" in runs.diagnosis
    assert "energy rose" in runs.diagnosis
    traced = jax.jit(lambda strength: sj.simulate(thrown(Pump(strength)), TIMES).status)
    assert [int(traced(strength)) for strength in strengths] == expected


def test_who_does_not_promise_is_not_held_to_it_and_its_work_is_counted():
    run = sj.simulate(thrown(HonestPump(0.01)), TIMES)
    assert run.succeeded
    energy = run.mechanical_energy
    assert energy[-1] - energy[0] > 1e-4
    np.testing.assert_allclose(run.supplied_work, energy - energy[0], rtol=1e-6, atol=1e-12)


def driven(force=None) -> sj.Scene:
    """A motor swings a rod, and a second one hangs on it in rubber."""
    rod = sj.Body(1.0, (0.01, 0.02, 0.03), position=(0.3, 0.0, 0.0), points={"tip": (0.2, 0.0, 0.0)})
    ball = sj.Body(0.4, (0.001, 0.002, 0.003), position=(0.8, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0)})
    joints = {
        "pivot": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        "motor": sj.RotationDriver(("ground", "rod"), (0.0, 1.0, 0.0), sj.functions.Sine(0.5, 2.0)),
        "rubber": sj.Spherical("rod.tip", "ball.end", sj.Bushing(1e4, 1e-3)),
    }
    return sj.Scene({"rod": rod, "ball": ball}, joints, {} if force is None else {"pump": force})


@pytest.mark.parametrize(
    ("solver", "share"),
    [(None, 1e-7), (sj.solvers.Rodas5P(), 1e-6), (sj.solvers.Ros34PW2(), 1e-4)],
    ids=["Dopri8", "Rodas5P", "Ros34PW2"],
)
def test_the_work_of_drivers_closes_the_balance(solver, share):
    """Power of a driver is lambda.Phi_t: a Rosenbrock method's linear systems must know how it depends on lambda."""
    run = sj.simulate(driven(), TIMES, solver=solver, rtol=1e-6, track_work=True)
    energy, loss = run.mechanical_energy, run.dissipated_energy("rubber")
    assert loss[-1] > 1e-3
    gap = energy - energy[0] - run.supplied_work + loss
    assert float(jnp.max(jnp.abs(gap))) < share * float(jnp.max(jnp.abs(run.supplied_work)))
    share = np.asarray(run.stats.audit)[CHECKS.index("energy")]
    if solver is None:
        assert 0 <= share < 0.1
    else:
        assert share == NOT_MADE
        assert "energy is not audited: this method" in run.audit


def test_a_driven_scene_is_audited_for_energy():
    with pytest.warns(sj.SimulationWarning, match="the energy rose by more than was put in"):
        run = sj.simulate(driven(Pump(2.0)), TIMES, rtol=1e-6)
    assert int(run.status) == Status.AUDIT_FAILED


def test_a_failed_audit_names_the_joint_and_the_body():
    ball = sj.Body(0.2, (1e-5, 1e-5, 1e-5), position=(3e-4, 0.0, 0.0), points={"center": (0.0, 0.0, 0.0)})
    rod = sj.Body(0.2, (1e-5, 1e-5, 1e-5), position=(0.1, 0.0, 0.0))
    joints = {
        "socket": sj.Spherical("ground.center", "ball.center", sj.Dry(1e-4), starts_concentric=False),
        "hinge": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    }
    scene = sj.Scene({"ball": ball, "rod": rod}, joints, ground_points={"center": (0.0, 0.0, 0.0)})
    system = sj.equations.compile_scene(scene).system
    state = described_state(system)
    y = np.concatenate([state, np.zeros(system.layout.size - state.size)])
    y[7:10] += [0.0, 2e-3, 0.0]  # the rod leaves its hinge
    y[10:14] *= 1.1
    found = suspects(system, 0.0, y)
    assert found["flight"] == "the ball of joint 'socket', by 2 clearances"
    assert found["energy"] == "the ball of joint 'socket' is 2 clearances outside"
    assert found["constraints"].startswith("joint 'hinge' gapes by 0.0")
    assert found["quaternions"] == "body 'rod'"
    text = findings([2.0, 0.5, 0.5, 3.0, 0.5, 0.2, 0.1, *[0.1] * (len(CHECKS) - 7)], found)
    assert text.startswith("the energy rose by more than was put in (2 times the limit: the ball of joint 'socket'")
    assert "were violated (3 times the limit: joint 'hinge'" in text
    assert "quaternion" not in text
    # An angle about an axis that has tipped over is not mended by a tighter tolerance.
    turns, axes = CHECKS.index("turns"), CHECKS.index("axes")
    shares = np.full(len(CHECKS), 0.1)
    shares[turns] = 1.4
    assert "tighten rtol" in findings(shares)
    shares[axes] = 7.0
    assert "tighten rtol" not in findings(shares)
    assert "give the two bodies a joint about that axis" in findings(shares)


def test_every_sound_run_shows_what_was_looked_at():
    joint = sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1))
    run = sj.simulate(sj.gallery.four_bar(joint), jnp.linspace(0.0, 0.05, 6))
    assert [check for check in CHECKS if check not in run.audit] == [
        "rotations", "turns", "tilt", "film", "film_range", "axes",
    ]  # nothing has an angle, a ball may tilt, and it is dry  # fmt: skip
    shares = np.asarray(run.stats.audit)
    assert shares.shape == (len(CHECKS),)
    assert np.all(shares < 0.1)
    assert shares[CHECKS.index("constraints")] > 0  # it was computed


@pytest.mark.parametrize(
    ("scene", "supplied", "dissipates"),
    [
        (sj.gallery.four_bar(), False, False),
        (sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall())), False, True),
        (sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.LuGre())), True, False),
        (sj.gallery.four_bar(sj.Lubricated(1e-4)), False, True),
        (sj.gallery.four_bar(sj.Bushing(1e6, 1e-4)), False, True),
        (sj.gallery.suspension(sj.Ideal()), True, False),  # a road that passes below, and a shock absorber's function
        (sj.gallery.car_axis(), True, False),  # a driver
        (cases.ball_in_socket(sj.Dry(1e-4, normal=sj.Flores(0.2))), False, False),  # without constraints
    ],
    ids=["ideal", "dry", "bristles", "lubricated", "bushing", "road", "driver", "free"],
)
def test_who_pays_for_accounts_of_energy(scene, supplied, dissipates):
    """One entry of the state where a part may add energy, one where parts dissipate beside constraints, else none."""
    system = sj.equations.compile_scene(scene).system
    assert system.layout.n_work == supplied + dissipates
    assert (system.tracks_supply, system.tracks_constraint_work) == (supplied, dissipates)


LIMITS = Limits(energy=jnp.array(1e-3), loss=jnp.array(1e-3), least=jnp.array(1e-9), violation=jnp.array(1e-3))
SOUND = Vitals(*map(jnp.asarray, (1.0, 2.0, -0.3, 1e-9, 1e-12, 0.3, 0.2, 0.4, 1e-6, 0.1)))


@pytest.mark.parametrize(
    ("check", "wrong"),
    [
        ("energy", SOUND._replace(agitation=jnp.asarray(2.01))),
        ("loss", SOUND._replace(agitation=jnp.asarray(1.99))),
        ("flight", SOUND._replace(outside=jnp.asarray(2 * OUTSIDE))),
        ("constraints", SOUND._replace(violation=jnp.asarray(2e-3))),
        ("quaternions", SOUND._replace(norm=jnp.asarray(0.1))),
        ("energy", SOUND._replace(potential=jnp.asarray(jnp.nan))),
        ("rotations", SOUND._replace(rotations=jnp.asarray(1.1))),
        ("turns", SOUND._replace(turns=jnp.asarray(1.5))),
    ],
)
def test_each_check_fails_on_what_it_is_for(check, wrong):
    watch = LIMITS.seen(LIMITS.begun(SOUND), SOUND)
    assert bool(watch.is_sound)
    watch = LIMITS.seen(watch, wrong)
    assert not bool(watch.is_sound)
    shares = np.asarray(watch.worst)
    expected = [check] if np.isfinite(wrong.potential) else ["energy", "loss"]
    assert [name for name, share in zip(CHECKS, shares, strict=True) if not share <= 1] == expected
    assert findings(shares).count("times the limit") == len(expected)
    # What was found once stays found.
    assert not bool(LIMITS.seen(watch, SOUND).is_sound)


@pytest.mark.parametrize(
    ("vital", "remedy"),
    [
        ("pressed", "a ball conformity=sj.laws.SphericalProfile() or sj.laws.WinklerLiner(...)"),
        ("tilt", "give the bearing its other rim"),
        ("offset", "leave e_h1 and e_h0 out"),
        ("axes", "give the two bodies a joint about that axis"),
    ],
)
def test_use_beyond_a_range_is_said_and_fails_nothing(vital, remedy):
    watch = LIMITS.seen(LIMITS.begun(SOUND), SOUND._replace(**{vital: jnp.asarray(1.5)}))
    assert bool(watch.is_sound)
    assert cautions(LIMITS.begun(SOUND).worst) == findings(watch.worst) == ""
    assert remedy in cautions(watch.worst)
    assert "(1.5 times that)" in cautions(np.stack([watch.worst, LIMITS.begun(SOUND).worst]))


def test_what_goes_beyond_a_range_is_named_by_the_parts_that_have_one():
    """Each text by its own parts; there was one list of parts before all texts."""
    scene = dry_and_oiled()
    system = sj.equations.compile_scene(scene).system
    state = described_state(system)
    y = np.concatenate([state, np.zeros(system.layout.size - state.size)])
    parts = parts_with_a_range(system, y)
    assert parts == {
        "conformity": ["joint 'dry'", "joint 'second'"],
        "tilt": [],
        "film": ["joint 'oiled'"],
        "film_range": [],
        "axes": ["force element 'torsion'"],
    }
    assert parts_with_a_range(system, np.full_like(y, np.nan)) == parts  # of a run that has failed
    shares = np.full(len(CHECKS), 0.1)
    shares[CHECKS.index("axes")] = 1.5
    assert cautions(shares, parts).startswith("force element 'torsion': the axis")
    shares[CHECKS.index("conformity")] = 2.0
    first, second = cautions(shares, parts).split("; ")[0], cautions(shares, parts).split("; ")[-1]
    assert first.startswith("one of joint 'dry', joint 'second': surfaces were pressed in")
    assert second.startswith("force element 'torsion': the axis")


def test_a_film_beyond_its_range_is_said_with_the_cause_that_its_scene_can_have():
    lined = sj.laws.LinedBearing(0.01, sj.laws.WinklerLiner(1e8, 0.4, 1e-3), points=16)
    oil, thickening = {"conformity": sj.laws.JohnsonCylinder(0.01)}, sj.laws.BarusThickening(2e-8)
    short = sj.laws.ShortBearing(0.01)
    shares = np.full(len(CHECKS), 0.1)
    shares[CHECKS.index("film_range")] = 1.5
    for options, is_out, is_thick in (
        ({"film": lined}, True, False),
        ({"film": short, "thickening": thickening}, False, True),
    ):
        scene = sj.gallery.journal_bearing(sj.Lubricated(1e-4, **options, **oil))
        system = sj.equations.compile_scene(scene).system
        state = described_state(system)
        y = np.concatenate([state, np.zeros(system.layout.size - state.size)])
        said = cautions(shares, parts_with_a_range(system, y), texts_for(system))
        assert said.startswith("joint 'bearing': a film was used beyond its range: ")
        assert ("further out than 0.8" in said, "alpha q > 0.7" in said) == (is_out, is_thick)
    socket = sj.laws.LinedSocket(sj.laws.WinklerLiner(1e9, 0.4, 8e-3), rings=4, around=8)
    hip = sj.equations.compile_scene(sj.gallery.hip(sj.Lubricated(8e-5, film=socket))).system
    assert "on a LinedSocket" in texts_for(hip)["film_range"]
    assert "further out than 0.8" not in texts_for(hip)["film_range"]
    both = cautions(shares)
    assert "further out than 0.8" in both
    assert "on a LinedSocket" in both
    assert "alpha q > 0.7" in both


def dry_and_oiled() -> sj.Scene:
    """Two dry balls and one in oil on a body that a torsional spring holds."""
    at = {"a": (0.1, 0.0, 0.0), "b": (0.0, 0.1, 0.0), "c": (0.0, 0.0, 0.1)}
    body = sj.Body(1.0, (1e-3, 1e-3, 1e-3), points=at)
    dry = sj.Dry(1e-4, normal=sj.LankaraniNikravesh(0.9))
    joints = {
        "dry": sj.Spherical("ground.a", "body.a", dry),
        "second": sj.Spherical("ground.b", "body.b", dry),
        "oiled": sj.Spherical("ground.c", "body.c", sj.Lubricated(1e-4, conformity=sj.laws.SphericalProfile())),
    }
    spring = sj.TorsionalSpring(("ground", "body"), (0.0, 0.0, 1.0), 0.1)
    return sj.Scene({"body": body}, joints, {"torsion": spring}, ground_points=at)


def pressed(modulus=1e8, conformity=None):
    """A ball of soft material that falls on the wall of its socket."""
    soft = sj.Material(modulus, 0.3)
    return cases.ball_in_socket(
        sj.Dry(1e-4, normal=sj.Flores(0.2), socket_material=soft, ball_material=soft, conformity=conformity),
        velocity=(0.0, 0.0, -0.1),
    )


def test_a_run_beyond_the_range_of_eq_24_says_so_and_names_the_joint():
    with pytest.warns(sj.errors.OutOfRangeWarning, match="joint 'joint'.*beyond the range of their elastic law"):
        run = sj.simulate(pressed(), jnp.linspace(0, 5e-3, 6))
    assert run.status == sj.Status.SUCCEEDED
    assert "beyond the range" in run.audit
    share = float(run.stats.audit[CHECKS.index("conformity")])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # What the message advises; the profile of spheres has no such limit.
        run = sj.simulate(pressed(conformity=sj.laws.SphericalProfile()), jnp.linspace(0, 5e-3, 6))
    assert float(run.stats.audit[CHECKS.index("conformity")]) == NOT_MADE
    with pytest.warns(sj.errors.OutOfRangeWarning, match=f"{share:.2g}"):
        swept = sj.sweep(pressed, {"modulus": [1e8, 1e11]}, [0.0, 5e-3], record=["onsets.joint"], progress=False)
    assert "beyond the range" in swept.attrs["cautions"]
    flags = dict(zip(swept["warnings"].flag_meanings.split(), swept["warnings"].flag_masks, strict=True))
    assert swept["warnings"].values.tolist() == [flags["conformity"], 0]
    (runs,) = flagged_runs(swept)
    assert (runs.what, runs.n, runs.ranges(swept)) == ("conformity", 1, {"modulus": (1e8, 1e8)})
    with pytest.warns(sj.errors.OutOfRangeWarning):
        simulate_many(pressed, {"modulus": np.array([1e8, 1e11])}, [0.0, 5e-3])


def test_what_a_step_may_lose_by_its_error_is_not_counted():
    """1e-8 of the energy in each of 1,000 steps is no finding, 1e-2 in one of them is."""
    watch, lost = LIMITS.begun(SOUND), 0.5 * LOST_IN_A_STEP * 1e-3 * 2.0  # of what moves, 2 J
    drained = LIMITS.seen(watch, SOUND._replace(agitation=jnp.asarray(2.0 - lost)))
    assert float(drained.worst[CHECKS.index("loss")]) == 0.0
    energy = jnp.asarray(2.0)
    for _ in range(1000):
        energy = energy - lost
        watch = LIMITS.seen(watch, SOUND._replace(agitation=energy))
    assert float(watch.worst[CHECKS.index("loss")]) == 0.0
    assert not bool(LIMITS.seen(watch, SOUND._replace(agitation=energy - 0.01)).is_sound)


def test_where_parts_dissipate_losing_energy_is_no_finding_and_gaining_it_back_is():
    lost = SOUND._replace(agitation=jnp.asarray(1.0))
    unknown = Limits(LIMITS.energy, jnp.array(np.inf), LIMITS.least, LIMITS.violation)
    watch = unknown.seen(unknown.begun(SOUND), lost)
    assert bool(watch.is_sound)
    assert float(watch.worst[CHECKS.index("loss")]) == NOT_MADE
    assert not bool(unknown.seen(watch, SOUND).is_sound)


def test_where_parts_dissipate_the_work_of_constraint_forces_is_judged():
    sound = SOUND._replace(constraint_work=jnp.zeros(()))
    lost = sound._replace(agitation=jnp.asarray(1.0))  # to a damper
    watch = LIMITS.seen(LIMITS.begun(sound), lost)
    assert bool(watch.is_sound)
    assert not bool(LIMITS.seen(watch, lost._replace(constraint_work=jnp.asarray(-0.1))).is_sound)
