"""Code of a user's own is simulated as it is now: helpers, constants and methods that were written anew are seen."""

import array
import collections
import enum
import functools
import importlib
import logging
import pathlib
import re
import sys
import threading
import types
import warnings
from dataclasses import dataclass, make_dataclass

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.program_cache.installed import module_of
from spherejax.program_cache.user_code import user_code_fingerprint

TS = np.linspace(0.0, 0.1, 4)
GAIN = 3.0
TABLE = {"gain": 3.0}
SEEN: list[float] = []
n_calls = 0


def helper(x):
    """What the magnet looks up."""
    return GAIN * x


class Own(sj.forces.AbstractForce):
    """Pulls a body to the ground, by what is looked up in this module."""

    body: str = eqx.field(static=True)
    stiffness: float
    factor = 1.0

    def wrenches(self, t, motions):
        lift = -self.factor * self.stiffness * helper(motions[self.body].position[2]) * TABLE["gain"] / 3.0
        return {self.body: sj.forces.Wrench(jnp.stack([0.0 * lift, 0.0 * lift, lift]), jnp.zeros(3))}


class Counting(Own):
    """The same, which counts how often it is traced."""

    def wrenches(self, t, motions):
        global n_calls
        n_calls += 1
        return super().wrenches(t, motions)


class Collecting(Own):
    """The same, which collects what it is traced with."""

    def wrenches(self, t, motions):
        SEEN.append(len(SEEN))
        return super().wrenches(t, motions)


def scene(stiffness=10.0, kind=Own):
    body = sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 1.0))
    return sj.Scene({"bob": body}, {}, {"magnet": kind("bob", stiffness)}, gravity=(0.0, 0.0, 0.0))


def height(stiffness=10.0, kind=Own, **options):
    """After 0.1 s [m]: cos(0.1 w) with w^2 = 3 stiffness, as the module stands when it is imported."""
    return float(sj.simulate(scene(stiffness, kind), TS, **options).ys[-1, 2])


def expected(stiffness=10.0, gain=3.0):
    return pytest.approx(np.cos(0.1 * np.sqrt(gain * stiffness)), rel=1e-8)


def heights(stiffnesses):
    found = sj.simulate_many(lambda k: scene(k), {"k": jnp.asarray(stiffnesses)}, TS)
    return np.asarray(found.trajectories.ys[:, -1, 2])


THIS = sys.modules[__name__]

CHANGES = {
    "helper": lambda patch: patch.setattr(THIS, "helper", lambda x: 60.0 * x),
    "constant": lambda patch: patch.setattr(THIS, "GAIN", 60.0),
    "entry of a table": lambda patch: patch.setitem(TABLE, "gain", 60.0),
    "constant of the class": lambda patch: patch.setattr(Own, "factor", 20.0),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_was_written_anew_is_simulated(what, monkeypatch):
    """With the same numbers and with others, one by one and many at once, the scene itself and what is read of it."""
    made = scene()
    assert height() == expected()
    np.testing.assert_allclose(heights([10.0, 20.0])[0], np.cos(0.1 * np.sqrt(30.0)), rtol=1e-8)
    with monkeypatch.context() as patch:
        CHANGES[what](patch)
        assert height() == expected(gain=60.0)
        assert height(11.0) == expected(11.0, gain=60.0)
        run = sj.simulate(made, TS)
        assert float(run.ys[-1, 2]) == expected(gain=60.0)
        assert float(run.acceleration("bob")[0, 2]) == pytest.approx(-600.0)
        np.testing.assert_allclose(heights([10.0, 20.0])[0], np.cos(0.1 * np.sqrt(600.0)), rtol=1e-8)
    assert height() == expected()
    assert float(sj.simulate(made, TS).ys[-1, 2]) == expected()


class Pulling:
    """An object that a scene calls, with what a user writes into between two runs."""

    def __init__(self):
        self.gain, self.table, self.array = 3.0, {"gain": [3.0]}, np.array([3.0])
        self.settings, self.latest = types.SimpleNamespace(gain=3.0), collections.deque([3.0])

    def __call__(self, t, motions):
        return self.pull(self.gain, motions)

    def by_table(self, t, motions):
        return self.pull(self.table["gain"][0], motions)

    def by_array(self, t, motions):
        return self.pull(self.array[0], motions)

    def by_settings(self, t, motions):
        return self.pull(self.settings.gain, motions)

    def by_latest(self, t, motions):
        return self.pull(self.latest[0], motions)

    @staticmethod
    def pull(gain, motions):
        lift = -10.0 * gain * motions["bob"].position[2]
        return jnp.stack([0.0 * lift, 0.0 * lift, lift])


@dataclass(eq=False)
class PullingFields:
    gain: float = 3.0

    def __call__(self, t, motions):
        return Pulling.pull(self.gain, motions)


class CountingObject(Pulling):
    """The same, which counts how often it is traced."""

    def __init__(self):
        super().__init__()
        self.n_calls = 0

    def __call__(self, t, motions):
        self.n_calls += 1
        return super().__call__(t, motions)


def _by_partial(table, t, motions):
    return Pulling.pull(table["gain"], motions)


class PullingTable(dict):
    """The same, by what is in it."""

    def __hash__(self):  # the structure of a scene is hashed
        return id(self)

    def __call__(self, t, motions):
        return Pulling.pull(self["gain"], motions)


def _with_attribute():
    def force(t, motions):
        return Pulling.pull(force.gain, motions)

    force.gain = 3.0
    return force


def _looking_up(numbers):
    return lambda t, motions: Pulling.pull(numbers[0], motions)


OBJECTS: dict[str, tuple] = {
    "an attribute of a function": (_with_attribute, lambda one: one, lambda one: setattr(one, "gain", 60.0)),
    "a table of a user's own class": (
        lambda: PullingTable(gain=3.0),
        lambda one: one,
        lambda one: one.__setitem__("gain", 60.0),
    ),
    "an array of Python": (lambda: array.array("d", [3.0]), _looking_up, lambda one: one.__setitem__(0, 60.0)),
    "an array with labels": (lambda: xarray.DataArray([3.0]), _looking_up, lambda one: one.__setitem__(0, 60.0)),
    "a field": (Pulling, lambda one: one, lambda one: setattr(one, "gain", 60.0)),
    "a list within a field": (Pulling, lambda one: one.by_table, lambda one: one.table["gain"].__setitem__(0, 60.0)),
    "an array": (Pulling, lambda one: one.by_array, lambda one: one.array.__setitem__(0, 60.0)),
    "a namespace": (Pulling, lambda one: one.by_settings, lambda one: setattr(one.settings, "gain", 60.0)),
    "a deque": (Pulling, lambda one: one.by_latest, lambda one: one.latest.appendleft(60.0)),
    "a dataclass": (PullingFields, lambda one: one, lambda one: setattr(one, "gain", 60.0)),
    "an argument of a partial": (
        lambda: {"gain": 3.0},
        lambda one: functools.partial(_by_partial, one),
        lambda one: one.__setitem__("gain", 60.0),
    ),
}


def pulled_scene(force):
    """The body of `scene`, which an applied force pulls."""
    body = sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 1.0))
    return sj.Scene({"bob": body}, {}, {"pull": sj.AppliedWrench("bob", force=force)}, gravity=(0.0, 0.0, 0.0))


def pulled(force):
    """Its height, as of `height`."""
    return float(sj.simulate(pulled_scene(force), TS).ys[-1, 2])


@pytest.mark.parametrize("what", OBJECTS)
def test_objects_that_were_written_into_are_other_code(what):
    """The structure of the scene stays equal: it holds the same object."""
    make, function_of, write = OBJECTS[what]
    one = make()
    structure = jax.tree.structure(pulled_scene(function_of(one)))
    before = user_code_fingerprint(structure)
    assert before == user_code_fingerprint(structure)
    write(one)
    assert before != user_code_fingerprint(structure)


def test_an_object_that_was_written_into_is_simulated_as_it_is():
    one = Pulling()
    assert pulled(one) == expected()
    one.gain = 60.0
    assert pulled(one) == expected(gain=60.0)


def test_an_object_that_counts_its_calls_is_named_and_traced_once():
    one = CountingObject()
    with pytest.warns(RuntimeWarning, match=r"what .*CountingObject.* looks up changed while it was simulated"):
        assert pulled(one) == expected()
    traced = one.n_calls
    assert pulled(one) == expected()
    assert one.n_calls == traced


def test_studies_see_it_too(monkeypatch):
    """Gradients, equilibria and modes: the body hangs in a guide, 1 / (gain stiffness) below the ground."""
    guide = sj.Prismatic(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))

    def hanging():
        body = sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 1.0))
        return sj.Scene({"bob": body}, {"guide": guide}, {"magnet": Own("bob", 10.0)}, gravity=(0.0, 0.0, -1.0))

    def found():
        rest = sj.equilibrium(hanging()).scene
        slope = jax.grad(lambda k: sj.simulate(scene(k), TS).ys[-1, 2])(10.0)
        frequency = sj.linearize(rest).modes().to_xarray()["frequency"].values.max()
        return float(slope), float(rest.bodies["bob"].position[2]), float(frequency)

    def expected_for(gain):
        rate = np.sqrt(10.0 * gain)
        return pytest.approx((-0.1 * np.sin(0.1 * rate) * gain / (2 * rate), -1 / (10.0 * gain), rate / 2 / np.pi))

    assert found() == expected_for(3.0)
    monkeypatch.setattr(THIS, "GAIN", 12.0)
    assert found() == expected_for(12.0)


def test_steps_of_a_state_that_was_made_before_see_it_too(monkeypatch):
    state = sj.start(scene())
    assert float(sj.advance(state, 0.1).y[2]) == expected()
    monkeypatch.setattr(THIS, "GAIN", 60.0)
    assert float(sj.advance(state, 0.1).y[2]) == expected(gain=60.0)


def test_a_method_that_was_replaced_is_called(monkeypatch):
    def wrenches(self, t, motions):
        lift = -100.0 * self.stiffness * motions[self.body].position[2]
        return {self.body: sj.forces.Wrench(jnp.stack([0.0 * lift, 0.0 * lift, lift]), jnp.zeros(3))}

    assert height() == expected()
    monkeypatch.setattr(Own, "wrenches", wrenches)
    assert height() == expected(gain=100.0)


def test_checks_that_were_written_anew_are_made(monkeypatch):
    def requirements(self):
        return [sj.laws.Requirement("stiffness", self.stiffness, self.stiffness > 50.0, "be large", "Give more.")]

    assert height() == expected()
    monkeypatch.setattr(Own, "requirements", requirements)
    with pytest.raises(sj.SceneError, match="force 'magnet': stiffness = 10 must be large"):
        height()
    monkeypatch.undo()
    assert height() == expected()


@pytest.mark.parametrize("is_imported_inside", [False, True])
def test_a_module_that_was_loaded_again_is_seen(is_imported_inside, tmp_path, monkeypatch):
    file = tmp_path / "helpers_of_mine.py"
    file.write_text("def pull(x):\n    return 3.0 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, "helpers_of_mine", raising=False)
    helpers = importlib.import_module("helpers_of_mine")

    def imported(x):
        from helpers_of_mine import pull  # pyright: ignore

        return pull(x)

    monkeypatch.setattr(THIS, "helper", imported if is_imported_inside else lambda x: helpers.pull(x))
    assert height() == expected()
    file.write_text("def pull(x):\n    return 45.0 * x\n")
    importlib.reload(helpers)
    assert height() == expected(gain=45.0)


def test_a_function_that_closes_over_a_number_is_told_by_it():
    """An adjustable closure: the function is the same object."""
    level = 2.0

    def force(t):
        return jnp.stack([0.0 * t, 0.0 * t, level + 0.0 * t])

    body = sj.Body(1.0, (1e-3, 1e-3, 1e-3))
    pushed = sj.Scene({"bob": body}, {}, {"push": sj.AppliedWrench("bob", force=force)}, gravity=(0.0, 0.0, 0.0))
    assert float(sj.simulate(pushed, TS).ys[-1, 2]) == pytest.approx(0.01)
    level = 4.0
    assert float(sj.simulate(pushed, TS).ys[-1, 2]) == pytest.approx(0.02)


def test_a_solver_of_a_users_own_is_the_one_that_it_is_now(monkeypatch):
    class Mine(diffrax.Tsit5):
        def order(self, terms):
            return 5

    def steps(**options):
        return int(sj.simulate(scene(), TS, solver=Mine(), **options).stats.n_steps)

    before = steps(rtol=1e-9)
    monkeypatch.setattr(Mine, "order", lambda self, terms: 2)  # the step-size control goes by it
    assert steps(rtol=1e-9) != before


def test_code_that_is_not_watched_whole_any_more_is_named():
    class Appending(Own):
        def wrenches(self, t, motions):
            SEEN.append(1)
            return super().wrenches(t, motions)

    with pytest.warns(RuntimeWarning, match=r"what .*Appending looks up changed while it was simulated"):
        assert height(kind=Appending) == expected()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert height(11.0, kind=Appending) == expected(11.0)


def test_code_that_cannot_be_looked_into_is_named(monkeypatch):
    def fail(*_, **__):
        raise RecursionError("too deep")

    monkeypatch.setattr("spherejax.program_cache.user_code.code_fingerprint", fail)
    with pytest.warns(RuntimeWarning, match=r"Own cannot be looked into \(RecursionError: too deep\)"):
        assert height() == expected()


@pytest.mark.filterwarnings("ignore:what .* looks up changed")
@pytest.mark.parametrize("kind", [Counting, Collecting])
@pytest.mark.parametrize("options", [{}, {"scalar": False}], ids=["scalar", "arrays"])
def test_code_that_counts_how_often_it_is_traced_is_traced_once(kind, options, monkeypatch):
    def n_traced():
        return n_calls + len(SEEN)

    assert height(kind=kind, **options) == expected()
    height(kind=kind, **options)
    traced = n_traced()
    for stiffness in (10.0, 11.0, 12.0):
        assert height(stiffness, kind=kind, **options) == expected(stiffness)
    assert n_traced() == traced
    monkeypatch.setattr(THIS, "GAIN", 60.0)  # and is looked at all the same
    assert height(kind=kind, **options) == expected(gain=60.0)
    assert n_traced() > traced


class Broken:
    """Cannot be looked at."""

    def __init__(self):
        self.itself = self

    def __repr__(self):
        raise RuntimeError("not to be shown")

    __slots__ = ("itself",)


LOOKED_UP = {
    "a logger": logging.getLogger("spherejax.tests"),
    "a lock": threading.Lock(),
    "a table": xarray.Dataset({"x": ("t", np.arange(5.0))}),
    "what cannot be shown": Broken(),
    "a network": eqx.nn.MLP(1, 1, 2, 1, key=jax.random.PRNGKey(0)),
}
TOOL = None


class Using(Own):
    """The same, which looks something up."""

    def wrenches(self, t, motions):
        assert TOOL is not None
        return super().wrenches(t, motions)


@pytest.mark.parametrize("what", LOOKED_UP)
def test_whatever_code_looks_up_a_run_is_made_and_is_not_traced_again(what, monkeypatch):
    monkeypatch.setattr(THIS, "TOOL", LOOKED_UP[what])
    monkeypatch.setattr(THIS, "n_calls", 0)

    class Counted(Using):
        def wrenches(self, t, motions):
            global n_calls
            n_calls += 1
            return super().wrenches(t, motions)

    assert height(kind=Counted) == expected()
    height(kind=Counted)
    traced = n_calls
    logging.getLogger("spherejax.tests").isEnabledFor(10)  # it remembers that it was asked
    assert height(11.0, kind=Counted) == expected(11.0)
    assert n_calls == traced


def test_scenes_without_such_code_have_none():
    for made in (sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall())), sj.gallery.car_axis()):
        structure, _ = flatten_system(compile_scene(made).system)
        assert structure.code == user_code_fingerprint(jax.tree.structure(made)) == ""
    structure, _ = flatten_system(compile_scene(scene()).system)
    assert structure.code == user_code_fingerprint(jax.tree.structure(scene())) != ""


def test_classes_that_say_they_are_pythons_own_are_read():
    """Of `exec` without a `__name__` they name `builtins` as their module, of `make_dataclass` they name `types`."""
    text = "class Typed(Base):\n    def wrenches(self, t, motions):\n        return {factor} * self.stiffness\n"
    fingerprints = []
    for factor in (1.0, 2.0, 2.0):
        names = {"Base": Own}
        exec(text.format(factor=factor), names)
        assert names["Typed"].__module__ == "builtins"
        fingerprints.append(user_code_fingerprint(jax.tree.structure(names["Typed"]("bob", 1.0))))
    assert fingerprints[0] != fingerprints[1] == fingerprints[2]
    made = [make_dataclass("Made", [], bases=(Own,), namespace={"factor": factor}) for factor in (1.0, 2.0)]
    assert len({user_code_fingerprint(jax.tree.structure(kind("bob", 1.0))) for kind in made}) == 2


@pytest.mark.parametrize(
    "kind",
    [int, types.FunctionType, functools.partial, type(threading.Lock()), type(functools.cache(len)), pathlib.Path,
     collections.OrderedDict, type(re.compile("")), enum.Enum, types.MappingProxyType],
)  # fmt: skip
def test_classes_of_python_are_known_by_their_modules(kind):
    assert module_of(kind) == kind.__module__
