"""The program cache without spherejax: a copy of its folder, attached to another package, with blobs of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import spherejax.program_cache as program_cache

FOLDER = Path(program_cache.__file__).parent

MODULE = """
import jax.numpy as jnp

SCALE = 3.0

def scaled(x):
    traced.append(x.shape)
    return {"scaled": SCALE * jnp.linalg.norm(x), "kind": "toy"}

traced = []
"""

RUN = """
import contextlib, sys
from pathlib import Path
import jax, jax.numpy as jnp
import toy
from alone import cached_jit, folders, settings
loaded = []

def load(blobs):
    loaded.append(blobs)
    if sys.argv[1] == "refuse":
        raise RuntimeError("not here")

blobs = settings.ExtraBlobs(
    is_available=lambda: True,
    record=lambda: contextlib.nullcontext(lambda: {"name": b"code"}),
    load=load,
)
settings.configure(settings.Settings(
    package="toy",
    sources=Path(toy.__file__).parent,
    constant_folders=frozenset({"toy"}),
    extra_blobs=lambda: blobs,
))
assert folders.use(Path("cache")).why_not == ""
if sys.argv[1] == "users":
    function = cached_jit(lambda x: toy.scaled(x))
else:
    function = cached_jit(toy.scaled)
found = function(jnp.array([3.0, 4.0]))
assert float(found["scaled"]) == 15.0 and found["kind"] == "toy"
assert not any(name.startswith("spherejax") for name in sys.modules)
print(len(toy.traced), [{name: code.decode() for name, code in each.items()} for each in loaded])
"""


@pytest.fixture
def alone(tmp_path):
    """A folder with the program cache under another name, and a package that uses it."""
    copy = tmp_path / "alone"
    copy.mkdir()
    for file in (*FOLDER.glob("*.py"), *FOLDER.glob("*.pyi")):
        (copy / file.name).write_text(file.read_text().replace("spherejax.program_cache", "alone"))
    (tmp_path / "toy").mkdir()
    source = tmp_path / "toy" / "__init__.py"
    source.write_text(MODULE)
    os.utime(source, (0, 0))  # as it was before any process began

    def run(how: str = "") -> str:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), "JAX_PLATFORMS": "cpu"}
        done = subprocess.run(
            [sys.executable, "-c", RUN, how], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


def test_it_serves_another_package_across_processes(alone, tmp_path):
    assert alone() == "1 []"
    # The next process traces nothing, and is handed the blobs that the program calls before it is loaded.
    assert alone() == "0 [{'name': 'code'}]"
    # Blobs that this process cannot run: the program is compiled again.
    assert alone("refuse") == "1 [{'name': 'code'}]"
    # A constant in the sources.
    source = tmp_path / "toy" / "__init__.py"
    source.write_text(MODULE + "\nOTHER = 1\n")
    os.utime(source, (1, 1))
    assert alone() == "1 []"


def test_user_code_is_not_written(alone, tmp_path):
    assert alone("users") == "1 []"
    assert not (tmp_path / "cache" / "kept").exists()
    assert alone("users") == "1 []"
