"""Packages need not lie in the interpreter's own folders.

They come from modules of a cluster (PYTHONPATH), `pip install --target` and `uv run --with`.
"""

import functools
import importlib
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.program_cache import fingerprints, installed
from spherejax.program_cache.fingerprints import (
    code_fingerprint,
    known_fingerprint,
    own_parts,
    value_fingerprint,
)
from spherejax.program_cache.installed import is_installed

PACKAGES = Path(jax.__file__).parents[1]
SOURCES = Path(sj.__file__).parents[1]

RUN = """
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import spherejax as sj
from spherejax.program_cache import disk_cache
from spherejax.motion.equations.dynamics import state_rate
print(jax.__file__)
print(disk_cache.key_for(state_rate, jax.lax.scan, jax.vmap, diffrax.Dopri8()) is not None)
{run}
"""

RUNS = """
run = sj.simulate(sj.gallery.simple_pendulum(), np.linspace(0.0, 0.3, 4))
push = sj.AppliedWrench("ball", force=sj.functions.UserFunction(lambda t: jnp.array([0.0, 0.0, 2.0])))
scene = sj.Scene({"ball": sj.Body(1.0, (1e-3, 1e-3, 1e-3))}, {}, {"push": push}, gravity=(0.0, 0.0, 0.0))
print(run.status, round(float(sj.simulate(scene, np.linspace(0.0, 1.0, 3)).position("ball")[-1, 2]), 9))
"""


def in_a_process(cache, *path, run=""):
    """What a process says whose packages are found by PYTHONPATH alone."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path)), "SPHEREJAX_CACHE": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    # -S: without the interpreter's own site-packages
    done = subprocess.run(
        [sys.executable, "-S", "-c", RUN.format(run=run)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.split()


@pytest.fixture
def target(tmp_path):
    """A folder with the packages of this environment, as `pip install --target` leaves them."""
    folder = tmp_path / "target"
    folder.mkdir()
    for each in PACKAGES.iterdir():
        if each.suffix != ".pth":
            (folder / each.name).symlink_to(each)
    return folder


def test_programs_are_kept_where_packages_are_elsewhere(tmp_path, target):
    """It was a RecursionError: JAX was taken for code of the user's own."""
    found, is_kept = in_a_process(tmp_path / "cache", target, SOURCES)
    assert found.startswith(str(target))
    assert is_kept == "True"


@pytest.mark.slow
def test_runs_where_packages_are_elsewhere(tmp_path, target):
    found, is_kept, *run = in_a_process(tmp_path / "cache", target, SOURCES, run=RUNS)
    assert found.startswith(str(target))
    assert is_kept == "True"
    assert run == ["Status.SUCCEEDED", "1.0"]


@pytest.mark.slow
def test_runs_with_a_checkout_of_jax_are_not_kept(tmp_path, target):
    """Its version does not tell its code, and it is not looked into."""
    checkout = tmp_path / "checkout"
    checkout.mkdir()
    (target / "jax").unlink()
    (checkout / "jax").symlink_to(PACKAGES / "jax")
    found, is_kept, *run = in_a_process(tmp_path / "cache", checkout, target, SOURCES, run=RUNS)
    assert found.startswith(str(checkout))
    assert is_kept == "False"
    assert run == ["Status.SUCCEEDED", "1.0"]
    # Machine code is told by its own text, whatever it was made by.
    assert all(file.name.startswith("spherejax") for file in (tmp_path / "cache" / "kept").iterdir())


# What is installed ----------------------------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Makes a module in a folder of the search path."""
    monkeypatch.syspath_prepend(tmp_path)

    def made(name, text="def doubled(x):\n    return 2 * x\n"):
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        installed._is_distributed.cache_clear()
        installed._distributed_in.cache_clear()
        return importlib.import_module(name)

    yield made
    for name in [name for name, module in sys.modules.items() if str(tmp_path) in str(getattr(module, "__file__", ""))]:
        del sys.modules[name]
    installed._is_distributed.cache_clear()
    installed._distributed_in.cache_clear()


def described(folder, *listed, name="something-1.0.dist-info"):
    """Say in a folder that a distribution has some files."""
    (folder / name).mkdir()
    (folder / name / "METADATA").write_text("Metadata-Version: 2.1\nName: something\nVersion: 1.0\n")
    (folder / name / "RECORD").write_text("".join(f"{file},sha256=abc,1\n" for file in listed))


def test_what_a_distribution_lists_is_installed_and_what_lies_beside_it_is_not(tmp_path, package):
    described(tmp_path, "listed_by_it.py", "something/__init__.py")
    listed, beside = package("listed_by_it"), package("not_listed_by_it")
    assert is_installed("listed_by_it", None)
    assert is_installed("listed_by_it", listed.doubled.__code__.co_filename)
    assert not is_installed("not_listed_by_it", beside.__file__)


def test_a_project_that_is_being_developed_is_not_installed(tmp_path, package):
    """`pip install -e` leaves its egg-info beside the sources; the code changes, and the version does not."""
    egg = tmp_path / "mine_in_development.egg-info"
    egg.mkdir()
    (egg / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (egg / "top_level.txt").write_text("mine_in_development\n")
    assert not is_installed("mine_in_development", package("mine_in_development").__file__)


def test_a_function_that_has_borrowed_the_name_of_one_of_jax_is_looked_into():
    def borrowed(factor):
        @functools.wraps(jnp.sin)
        def sine(x):
            return factor * x

        return sine

    one, two = borrowed(2.0), borrowed(3.0)
    assert one.__module__.startswith("jax.")
    assert value_fingerprint(one) != value_fingerprint(two)


# However deep ---------------------------------------------------------------------------------------------------------


def chain(n, last):
    """Functions that look each other up, one after the other."""
    function = eval(f"lambda x: x + {last}")
    for _ in range(n):
        function = (lambda inner: lambda x: inner(x))(function)
    return function


def test_a_long_chain_of_functions_is_told_to_its_end():
    assert code_fingerprint((chain(3000, 1),)) == code_fingerprint((chain(3000, 1),))
    assert code_fingerprint((chain(3000, 1),)) != code_fingerprint((chain(3000, 2),))


def test_lists_in_lists_are_told_to_the_innermost():
    def nested(number):
        value = [number]
        for _ in range(5000):
            value = [value, ()]
        return value

    assert value_fingerprint(nested(1)) == value_fingerprint(nested(1)) != value_fingerprint(nested(2))
    assert known_fingerprint(nested(1)) == known_fingerprint(nested(1)) != known_fingerprint(nested(2))


def test_a_function_that_looks_up_the_set_it_is_in_has_an_end():
    def found(number):
        return [each for each in known if each(0) == number]

    known = {found}
    assert value_fingerprint(known) == value_fingerprint(known)
    assert known_fingerprint(known) is None


def test_code_of_a_users_own_in_a_set_is_met():
    def mine(x):
        return x

    assert own_parts(frozenset({mine})) == (mine,)
    assert own_parts(frozenset({np.sin, "a"})) == ()


def test_a_library_that_nobody_has_installed_is_not_looked_into_without_end(monkeypatch):
    monkeypatch.setattr(fingerprints, "MOST", 100)
    assert code_fingerprint((chain(50, 1),))
    with pytest.raises(RuntimeError, match="more than 100 functions and classes"):
        code_fingerprint((chain(200, 1),))
