"""A user's program holds the runs in it as operations, takes them in as another process has lowered them, and computes
the same."""

import hashlib
import os
import subprocess
import sys

import diffrax
import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.integration import one_run
from spherejax.program_cache import cached_jit, disk_cache, folders
from spherejax.program_cache.fingerprints import program_fingerprint

TS = jnp.linspace(0.0, 0.01, 4)

PROCESS = """
import jax, jax.numpy as jnp
import spherejax as sj
names = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **said: names.append(str(said.get("fun_name"))) if "to_mlir_module" in event else None
)
ts = jnp.linspace(0.0, 0.01, 4)
def height(c, mu, **options):
    joint = sj.Dry(c, friction=sj.Threlfall(mu=mu))
    return sj.simulate(sj.gallery.four_bar(joint), ts, **options).ys[-1, 2]
found = [*jax.jit(jax.value_and_grad(lambda c: height(c, 0.1)))(1e-4)]
found += [*jax.vmap(lambda c: height(c, 0.2))(jnp.linspace(1e-4, 2e-4, 3))]
found += [jax.jit(lambda c: height(c, 0.2, scalar=False, solver=sj.solvers.Rodas5P()))(1e-4)]
print(*(float(each).hex() for each in found))
print(names.count("jit(to_be_lowered)"))
"""


def in_a_process(cache):
    """What a program came to, and how many operations were traced to be lowered."""
    environment = {**os.environ, "SPHEREJAX_CACHE": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", PROCESS], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stderr == ""
    *numbers, n_made = done.stdout.split()
    return numbers, int(n_made)


@pytest.mark.slow
def test_the_next_process_lowers_no_run_and_computes_the_same_bits(tmp_path):
    """With derivatives, of many runs, and on the array path by a method that calls LAPACK."""
    first, n_made = in_a_process(tmp_path)
    assert n_made == 2  # what is mapped outside of `jit` is a program of its own
    assert in_a_process(tmp_path) == (first, 0)
    assert in_a_process("0")[0] == first


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of this process, which has no runs yet."""
    monkeypatch.setattr(folders, "_in_use", [tmp_path])
    forget()
    return tmp_path


def forget():
    """Let the runs of this process go."""
    one_run.integrated.clear()
    one_run._with_slopes.clear()


_lowered: list[str] = []


def _heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if "to_mlir_module" in event:
        _lowered.append(str(kwargs.get("fun_name")))


jax.monitoring.register_event_duration_secs_listener(_heard)


@pytest.fixture
def n_lowered():
    """How many operations have been lowered; to replace a function would be code of a user's own."""
    _lowered.clear()
    return lambda: _lowered.count("jit(to_be_lowered)")


def keys_of_lowered(folder):
    """Of what was kept in a folder."""
    kept = {file.name: disk_cache.load(file.name) for file in (folder / "kept").iterdir()}
    return [key for key, each in kept.items() if isinstance(each, tuple) and len(each) == 2 and _is_lowered(each[0])]


def _is_lowered(value):
    return isinstance(value, tuple) and len(value) == 3 and value[0].startswith(b"ML")


def place(length, ts=TS, **options):
    """Of a bob [m] after 10 ms."""
    return sj.simulate(sj.gallery.simple_pendulum(length=length), ts, **options).ys[-1, 0]


def test_a_run_within_a_program_is_lowered_once(folder, n_lowered):
    expected = place(2.0)
    assert n_lowered() == 0
    for _ in range(2):  # JAX traces the second one anew, and remembers nothing of the first
        forget()
        assert float(jax.jit(lambda length: place(length))(2.0)) == pytest.approx(float(expected), rel=1e-12)
    assert n_lowered() == 1
    jax.jit(lambda length: place(length, TS[:3]))(2.0)
    assert n_lowered() == 2


def test_runs_of_several_kinds_are_taken_in_side_by_side(folder, n_lowered):
    def both(length):
        first, again = place(length), place(2 * length)
        slopes = jax.grad(place)(length)
        many = jax.vmap(place)(jnp.stack([length, 3 * length]))
        return jnp.stack([first, again, slopes, *many])

    found = []
    for _ in range(2):
        found.append(jax.jit(lambda length: both(length))(2.0))
        forget()
    np.testing.assert_array_equal(*found)
    assert n_lowered() == len(keys_of_lowered(folder)) == 3
    np.testing.assert_allclose(found[0], both(jnp.array(2.0)), rtol=1e-9, atol=1e-12)


def test_what_is_taken_in_is_called_by_names_of_its_own(folder):
    def heights(length):
        def whole(x):  # as functions within the runs are called
            return x * 2

        return jax.jit(whole)(place(length)) + jax.jit(whole)(place(length, rtol=1e-6))

    text = jax.jit(heights).lower(2.0).as_text()
    names = [line.split("@")[1].split("(")[0] for line in text.splitlines() if "func.func" in line]
    assert len(names) == len(set(names))
    assert sum(name.startswith("kept_") and name.count("_") == 1 for name in names) == 1
    expected = 2 * (place(2.0) + place(2.0, rtol=1e-6))
    assert float(jax.jit(heights)(2.0)) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize("damage", [b"", b"no module", None])
def test_what_cannot_be_read_is_lowered_anew(folder, n_lowered, damage):
    jax.jit(lambda length: place(length))(2.0)
    (key,) = keys_of_lowered(folder)
    if damage is None:
        (_, codes, shapes), static = disk_cache.load(key)
        disk_cache.save(key, ((b"ML", codes, shapes), static))
    else:
        (folder / "kept" / key).write_bytes(damage)
    forget()
    found = jax.jit(lambda length: place(length))(2.0)
    assert n_lowered() == 2
    assert keys_of_lowered(folder) == [key]
    assert float(found) == pytest.approx(float(place(2.0)), rel=1e-12)


def pulled(stiffness):
    scene = sj.Scene(
        bodies={"bob": sj.Body(1.0, (1e-3, 1e-3, 1e-3))}, joints={}, forces={"magnet": my_laws.Magnet("bob", stiffness)}
    )
    return sj.simulate(scene, TS).ys[-1, 2]


def test_without_a_folder_and_with_code_of_a_users_own_all_is_lowered_as_before(folder, n_lowered, monkeypatch):
    assert float(jax.jit(lambda stiffness: pulled(stiffness))(3.0)) == pytest.approx(float(pulled(3.0)), rel=1e-12)
    with monkeypatch.context() as patched:
        patched.setattr(folders, "_in_use", [])
        jax.jit(lambda length: place(length))(2.0)
    assert keys_of_lowered(folder) == []


def digest(text):
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
def operation(folder, monkeypatch):
    """A function of a number and a vector, with something static among its results, that is an operation."""
    monkeypatch.setattr(disk_cache, "key_for", lambda *what: digest(str(what)))  # as if it were ours

    @cached_jit(many="many")
    def scaled(a, x, word):
        return {"product": a * x, "word": word, "largest": jnp.max(x)}

    return scaled


def in_whole(operation, a, x):
    found = operation(a, x, "said")
    assert found["word"] == "said"
    return jnp.sum(found["product"]) + found["largest"]


X = jnp.array([1.0, -2.0, 0.5])

WAYS = {
    "jit": (jax.jit, (2.0, X)),
    "vmap": (lambda f: jax.vmap(f, (0, None)), (X, X)),
    "vmap of both": (jax.vmap, (X, jnp.stack([X, 2 * X, 3 * X]))),
    "vmap along the last axis": (lambda f: jax.vmap(f, (None, 1)), (2.0, jnp.stack([X, 2 * X], 1))),
    "nested": (lambda f: jax.vmap(jax.vmap(f, (0, None)), (None, 0)), (X, jnp.stack([X, 2 * X]))),
    "jit of nested": (lambda f: jax.jit(jax.vmap(jax.vmap(f, (None, 0)), (0, None))), (X, jnp.stack([X, 2 * X]))),
    "derivatives": (lambda f: jax.jit(lambda a, x: jax.jvp(f, (a, x), (3.0, X))), (2.0, X)),
    "gradient": (jax.grad, (2.0, X)),
    "gradients of many": (lambda f: jax.jit(jax.vmap(jax.grad(f, 1), (0, None))), (X, X)),
    "loop": (lambda f: jax.jit(lambda a, x: jax.lax.scan(lambda c, b: (f(c, b), c), a, jnp.stack([x, x]))), (2.0, X)),
    "condition": (lambda f: jax.jit(lambda a, x: jax.lax.cond(a > 0, f, lambda a, _: a, a, x)), (2.0, X)),
    "recomputed": (lambda f: jax.grad(jax.checkpoint(f)), (2.0, X)),
}
"""Transformations of a function, and where they are evaluated."""


@pytest.mark.parametrize("way", WAYS)
def test_an_operation_is_its_function_under_every_transformation(operation, way):
    transformed, arguments = WAYS[way]

    def plain(a, x):
        return jnp.sum(a * x) + jnp.max(x)

    for _ in range(2):  # traced, then as it was kept
        found = transformed(lambda a, x: in_whole(operation, a, x))(*arguments)
        jax.tree.map(np.testing.assert_array_equal, found, transformed(plain)(*arguments))
        operation.clear()


def test_where_nothing_can_be_kept_any_more_many_are_computed_all_the_same(operation, monkeypatch):
    """A source file that is written while a program is traced, say."""
    keys = iter(["1" * 64])
    monkeypatch.setattr(disk_cache, "key_for", lambda *_: next(keys, None))
    found = jax.jit(jax.vmap(lambda a: in_whole(operation, a, X)))(X)
    np.testing.assert_array_equal(found, X * jnp.sum(X) + 1.0)


def test_an_operation_is_told_by_what_it_computes_and_not_by_what_was_found_out(folder):
    def fingerprint(**options):
        return program_fingerprint(lambda length: place(length, **options), jax.ShapeDtypeStruct((), jnp.float64))

    before, other = fingerprint(), fingerprint(solver=diffrax.Tsit5())
    assert before != other
    jax.jit(lambda length: place(length))(2.0)
    assert fingerprint() == before
    forget()
    assert (fingerprint(), fingerprint(solver=diffrax.Tsit5())) == (before, other)


def test_a_run_is_one_operation_of_a_program(folder):
    made = jax.make_jaxpr(jax.vmap(jax.grad(place)))(jnp.array([1.0, 2.0]))
    assert str(made).count("within[") == 1


def test_what_calls_python_stays_in_its_process(folder, monkeypatch):
    def called(x):
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), jnp.float64), x)

    monkeypatch.setattr(disk_cache, "key_for", lambda *_: "0" * 64)  # as if it were of this package
    sine = cached_jit(called, many="sines")
    assert float(jax.jit(lambda x: sine(x) + 1)(0.5)) == 1 + np.sin(0.5)
    assert not (folder / "kept").exists()
