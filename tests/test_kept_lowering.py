"""A user's program takes in the runs in it as another process has lowered them, and computes the same."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest

import spherejax as sj
from spherejax import runtime
from spherejax.foundations.kept import kept_lowering, kept_on_disk

TS = jnp.linspace(0.0, 0.01, 4)

PROCESS = """
import jax, jax.numpy as jnp
import spherejax as sj
names = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **said: names.append(str(said.get("fun_name"))) if "trace_duration" in event else None
)
ts = jnp.linspace(0.0, 0.01, 4)
def height(c, mu, **options):
    joint = sj.Dry(c, friction=sj.Threlfall(mu=mu))
    return sj.simulate(sj.gallery.four_bar(joint), ts, **options).ys[-1, 2]
found = [*jax.jit(jax.value_and_grad(lambda c: height(c, 0.1)))(1e-4)]
found += [*jax.vmap(lambda c: height(c, 0.2))(jnp.linspace(1e-4, 2e-4, 3))]
found += [jax.jit(lambda c: height(c, 0.2, scalar=False, solver=sj.Rodas5P()))(1e-4)]
print(*(float(each).hex() for each in found))
print(names.count("to_be_lowered"))
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
    assert n_made >= 3
    assert in_a_process(tmp_path) == (first, 0)
    assert in_a_process("0")[0] == first


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of this process."""
    monkeypatch.setattr(runtime, "_kept", [tmp_path])
    return tmp_path


_traced: list[str] = []


def _heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if "trace_duration" in event:
        _traced.append(str(kwargs.get("fun_name")))


jax.monitoring.register_event_duration_secs_listener(_heard)


@pytest.fixture
def n_lowered():
    """How many operations have been traced to be lowered; to replace a function would be code of a user's own."""
    _traced.clear()
    return lambda: _traced.count("to_be_lowered")


def keys_of_lowered(folder):
    """Of what was kept in a folder."""
    kept = {file.name: kept_on_disk.load(file.name) for file in (folder / "kept").iterdir()}
    return [
        key for key, each in kept.items() if isinstance(each, tuple) and len(each) == 2 and each[0].startswith(b"ML")
    ]


def place(length, ts=TS, **options):
    """Of a bob [m] after 10 ms."""
    return sj.simulate(sj.gallery.simple_pendulum(length=length), ts, **options).ys[-1, 0]


def test_a_run_within_a_program_is_lowered_once(folder, n_lowered):
    expected = place(2.0)
    assert n_lowered() == 0
    for _ in range(2):  # JAX traces the second one anew, and remembers nothing of the first
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

    found = [jax.jit(lambda length: both(length))(2.0) for _ in range(2)]
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
        kept_on_disk.save(key, (b"ML", {}))
    else:
        (folder / "kept" / key).write_bytes(damage)
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
        patched.setattr(runtime, "_kept", [None])
        jax.jit(lambda length: place(length))(2.0)
    assert keys_of_lowered(folder) == []


def test_what_calls_python_stays_in_its_process(folder):
    def called(x):
        return (jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), jnp.float64), x),)

    assert kept_lowering._lowered("key", called, [jax.ShapeDtypeStruct((), jnp.float64)]) is None
    assert not (folder / "kept").exists()
