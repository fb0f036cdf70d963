"""A scene that is renewed from the one before, of which a few numbers are others, is what it is from the start."""

import warnings

import cases
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.errors import SceneError
from spherejax.model.renewal import Compilation, Taken
from spherejax.model.system import compile_scene, structure_and_numbers, with_laws_by_factor
from spherejax.motion.runs import preparation
from spherejax.motion.runs import simulate as simulating
from spherejax.program_cache.keys import KeyedTree, LruCache


def two_arms(hinge, ball) -> sj.Scene:
    """A scene with parts of many kinds."""
    arm = sj.Body(1.0, (1e-2, 1e-2, 1e-3), (0.3, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0), "tip": (0.3, 0.0, 0.0)})
    rod = sj.Body(0.5, np.diag([2e-3, 1e-2, 1e-2]), (0.9, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0)})
    joints = {
        "hinge": sj.Revolute(("ground", "arm"), "arm.end", (0.0, 1.0, 0.0), hinge),
        "ball": sj.Spherical("arm.tip", "rod.end", ball),
    }
    forces = {
        "spring": sj.SpringDamper(("ground.hook", "rod.end"), 100.0, 1.0, 0.3),
        "control": sj.PID(sj.Turn(("ground", "arm"), axis=(0.0, 1.0, 0.0)), 0.1, proportional=3.0, integral=0.5),
    }
    return sj.Scene({"arm": arm, "rod": rod}, joints, forces, ground_points={"hook": (0.9, 0.0, 0.3)})


SCENES = {
    "dry": lambda: sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-3))),
    "bushing": lambda: two_arms(sj.Ideal(), cases.MODELS["bushing"]),
    "film": lambda: two_arms(cases.JOURNALS["warm"], cases.MODELS["lubricated"]),
}
OTHERS = {f"ball {name}": lambda model=model: two_arms(sj.Ideal(), model) for name, model in cases.MODELS.items()} | {
    f"journal {name}": lambda model=model: two_arms(model, sj.Ideal()) for name, model in cases.JOURNALS.items()
}


def bits(leaves):
    return [(type(leaf), np.shape(leaf), np.asarray(leaf).tobytes()) for leaf in leaves]


def from_the_start(scene):
    system = Taken.apart(compile_scene(scene).system)
    return system, Taken.apart(with_laws_by_factor(system.whole()))


def with_leaf(scene, place, value):
    leaves, tree = jax.tree.flatten(scene)
    leaves[place] = value
    return jax.tree.unflatten(tree, leaves)


CHANGES_OF_A_NUMBER = (
    lambda x: x * 1.001 + 1e-6,
    lambda x: -x,
    lambda x: 0 * x,
    lambda x: 0 * x + 1,
    lambda x: x / 0.0,
)


@pytest.mark.parametrize(
    "build",
    [pytest.param(build, id=name) for name, build in SCENES.items()]
    + [pytest.param(build, id=name, marks=pytest.mark.slow) for name, build in OTHERS.items()],
)
@np.errstate(all="ignore")  # of infinity laws compute what is none
def test_each_number_that_changes_makes_what_it_makes_from_the_start(build):
    """Each leaf of a scene, made another number, a structural one, one that is refused, and none: a renewal is the
    same to the last bit, or there is none."""
    scene = build()
    reading = KeyedTree(scene)
    compilation = Compilation.of(reading, *from_the_start(scene))
    assert compilation is not None
    n_renewed, refused = 0, 0
    for place, leaf in enumerate(reading.leaves):
        for change in (
            lambda x: x * 1.001 + 1e-6,
            lambda x: -x,
            lambda x: 0 * x,
            lambda x: 0 * x + 1,
            lambda x: x / 0.0,
        ):
            other = with_leaf(scene, place, change(leaf))
            renewed = compilation.renewed(KeyedTree(other))
            try:
                system, seen = from_the_start(other)
            except SceneError:
                assert renewed is None
                refused += 1
                continue
            if renewed is None:
                continue
            n_renewed += 1
            assert renewed.conditions == []
            for one, whole in ((renewed.system, system), (renewed.seen, seen)):
                assert one.tree == whole.tree
                assert bits(one.leaves) == bits(whole.leaves)
            mine, its = structure_and_numbers(*renewed.seen), structure_and_numbers(*seen)
            assert mine[0] == its[0]
            assert mine[1].tobytes() == its[1].tobytes()
    assert n_renewed > 50
    assert refused > 10


@pytest.fixture
def warm(monkeypatch):
    """Empty tables, and how often scenes were compiled from the start."""
    calls = []
    original = preparation.compile_scene
    monkeypatch.setattr(preparation, "compile_scene", lambda *a, **k: calls.append(a) or original(*a, **k))

    def forget():
        for function in (preparation.prepared_from, simulating._call):
            monkeypatch.setattr(function, "table", LruCache(64))
        monkeypatch.setattr(preparation, "_lasts", LruCache(64))

    forget()
    return calls, forget


TS = jnp.array([0.0, 0.01, 0.02])


def answer(scene):
    """What a call answers: the motion and all that is said, or the error."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            run = sj.simulate(scene, TS)
        except SceneError as error:
            return str(error), [str(one.message) for one in said]
    return np.asarray(run.ys).tobytes(), run.stats.explanation, [str(one.message) for one in said]


def clearance(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.clearance, scene, np.float64(value))


def mass(scene, value):
    return eqx.tree_at(lambda s: s.bodies["coupler"].mass, scene, np.float64(value))


def restitution(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.normal.restitution, scene, np.float64(value))


CHANGES = {
    "a negative mass": lambda s: mass(s, -0.1),
    "no mass": lambda s: mass(s, 0.0),
    "an infinite mass": lambda s: mass(s, np.inf),
    "a mass of one": lambda s: mass(s, 1.0),
    "masses far apart": lambda s: mass(s, 1e-7),
    "a negative clearance": lambda s: clearance(s, -1e-4),
    "a clearance that is none": lambda s: clearance(s, np.nan),
    "a clearance beyond the socket": lambda s: clearance(s, 0.02),
    "a restitution of one": lambda s: restitution(s, 1.0),
    "another restitution": lambda s: restitution(s, 0.7),
    "both": lambda s: mass(clearance(s, 2e-4), 0.2),
    "two errors": lambda s: mass(clearance(s, -2e-4), -0.2),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_warm_call_answers_as_a_first_one(warm, change):
    calls, forget = warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    answer(scene)
    answer(clearance(scene, 1.1e-4))
    assert len(calls) == 1
    changed = CHANGES[change](scene)
    second = answer(changed)
    forget()
    assert second == answer(changed)


def test_a_film_that_is_not_for_its_bearing_is_doubted_after_a_warm_call(warm):
    """With each scene that calls for it, and with no other."""
    calls, forget = warm
    scene = two_arms(cases.JOURNALS["short"], sj.Ideal())
    length = cases.JOURNALS["short"].film.length
    found = []
    for times in (2.0, 2.1, 0.4, 2.0):
        found.append(preparation.prepared(_with_radius(scene, times * length), False, False).doubts)
    assert len(calls) == 1
    assert found[0] == found[1] == found[3] == ()
    assert "ShortBearing" in found[2][0]
    forget()
    assert found[2] == preparation.prepared(_with_radius(scene, 0.4 * length), False, False).doubts


def _with_radius(scene, radius):
    return eqx.tree_at(lambda s: s.joints["hinge"].model.socket_radius, scene, np.float64(radius))


def test_a_start_that_is_moved_is_said_each_time(warm):
    """A `StartWarning` hangs on the clearance, too, and comes with each call."""
    del warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    moved = eqx.tree_at(lambda s: s.bodies["coupler"].velocity, scene, np.array([0.0, 1.0, 0.0]))
    assert not answer(scene)[-1]
    first, second = answer(moved)[-1], answer(moved)[-1]
    assert first == second != []
    assert not answer(clearance(scene, 2e-4))[-1]


def test_what_is_traced_is_renewed_with_its_conditions(warm):
    """Within a trace of a user's, after a warm call: a bad value is the status of that run."""
    calls, _ = warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    traced = jax.jit(lambda c: sj.simulate(_with_traced(scene, c), TS).ended)
    answer(scene)
    good, bad = traced(jnp.asarray(1e-4)), traced(jnp.asarray(-1e-4))
    assert len(calls) == 1
    assert int(good) == sj.Status.SUCCEEDED
    assert int(bad) == sj.Status.BAD_VALUE


def _with_traced(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.clearance, scene, value)
