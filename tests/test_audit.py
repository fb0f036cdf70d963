"""Runs audit themselves: what cannot be ends a run, in single runs and in lanes, and is said in words."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.audit import CHECKS, OUTSIDE, Limits, Vitals, findings, never_adds_energy
from spherejax.motion.many import simulate_many
from spherejax.motion.status import Status

TIMES = jnp.linspace(0.0, 0.5, 6)


class Pump(sj.AbstractForce):
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
        return {"ball": sj.Wrench(self.strength * motions["ball"].velocity, jnp.zeros(3))}


class HonestPump(Pump):
    """The same, and says nothing."""

    claims: ClassVar[bool] = False


def thrown(force) -> sj.Scene:
    ball = sj.Body(0.2, (1e-5, 1e-5, 1e-5), velocity=(0.3, 0.0, 0.4), points={"center": (0.0, 0.0, 0.0)})
    return sj.Scene({"ball": ball}, {}, forces={"pump": force})


def test_energy_from_nowhere_ends_the_run_with_its_name_and_time():
    with pytest.warns(sj.SimulationWarning, match="the energy rose, though nothing in the scene can add any"):
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


def test_who_does_not_promise_is_not_held_to_it():
    run = sj.simulate(thrown(HonestPump(0.01)), TIMES)
    assert run.succeeded
    assert "energy is not audited" in run.audit


def test_every_sound_run_shows_what_was_looked_at():
    joint = sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1))
    run = sj.simulate(sj.gallery.four_bar(joint), jnp.linspace(0.0, 0.05, 6))
    assert all(check in run.audit for check in CHECKS)
    shares = np.asarray(run.stats.audit)
    assert shares.shape == (len(CHECKS),)
    assert np.all(shares < 0.1)
    assert shares[CHECKS.index("constraints")] > 0  # it was computed


@pytest.mark.parametrize(
    ("scene", "promised"),
    [
        (sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall())), True),
        (sj.gallery.four_bar(sj.Lubricated(1e-4)), True),
        (sj.gallery.four_bar(sj.Bushing(1e6, 1e-4)), True),
        (sj.gallery.suspension(sj.Ideal()), False),  # a road that passes below
    ],
    ids=["dry", "lubricated", "bushing", "road"],
)
def test_whose_energy_is_audited(scene, promised):
    assert never_adds_energy(sj.compile_scene(scene).system) == promised


LIMITS = Limits(energy=jnp.array(1e-3), least=jnp.array(1e-9), violation=jnp.array(1e-3))
SOUND = Vitals(*map(jnp.asarray, (1.0, 2.0, -0.3, 1e-9, 1e-12)))


@pytest.mark.parametrize(
    ("check", "wrong"),
    [
        ("energy", SOUND._replace(agitation=jnp.asarray(2.01))),
        ("flight", SOUND._replace(outside=jnp.asarray(2 * OUTSIDE))),
        ("constraints", SOUND._replace(violation=jnp.asarray(2e-3))),
        ("quaternions", SOUND._replace(norm=jnp.asarray(0.1))),
        ("energy", SOUND._replace(potential=jnp.asarray(jnp.nan))),
    ],
)
def test_each_check_fails_on_what_it_is_for(check, wrong):
    watch = LIMITS.seen(LIMITS.begun(SOUND), SOUND)
    assert bool(watch.is_sound)
    watch = LIMITS.seen(watch, wrong)
    assert not bool(watch.is_sound)
    shares = np.asarray(watch.worst)
    assert [name for name, share in zip(CHECKS, shares, strict=True) if not share <= 1] == [check]
    assert findings(shares).count("times the limit") == 1
    # What was found once stays found.
    assert not bool(LIMITS.seen(watch, SOUND).is_sound)


def test_losing_energy_is_no_finding_and_gaining_it_back_is():
    lost = SOUND._replace(agitation=jnp.asarray(1.0))
    watch = LIMITS.seen(LIMITS.begun(SOUND), lost)
    assert bool(watch.is_sound)
    assert not bool(LIMITS.seen(watch, SOUND).is_sound)
