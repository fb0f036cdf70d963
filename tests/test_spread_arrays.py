"""Arrays that are sharded over several devices give what arrays on one device give."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec

from spherejax.compiler import private
from spherejax.program_cache import several_devices

PROGRAM = """
import sys
import jax, jax.numpy as jnp, numpy as np, spherejax as sj
from jax.sharding import Mesh, NamedSharding, PartitionSpec
over_devices = NamedSharding(Mesh(np.array(jax.devices()), ("run",)), PartitionSpec("run"))
assert len(jax.devices()) == 2
times = np.linspace(0.0, 0.1, 3)
alone = np.linspace(1.0, 2.0, 4)

def end(mass):
    return sj.simulate(sj.gallery.physical_pendulum(mass=mass), times).ys[-1]

def rate(mass):
    return sj.simulate(sj.gallery.physical_pendulum(sj.Dry(1e-3), mass=mass), times).acceleration("rod")[-1]

def of_many(masses):
    runs = sj.simulate_many(lambda mass: sj.gallery.physical_pendulum(mass=mass), {"mass": masses}, times)
    return runs.trajectories.ys

calls = {
    "one": lambda masses: end(masses[1]),
    "vmap": jax.vmap(end),
    "jit": jax.jit(jax.vmap(end)),
    "gradient": jax.grad(lambda masses: jnp.sum(jax.vmap(end)(masses))),
    "jit of a gradient": jax.jit(jax.grad(lambda masses: jnp.sum(jax.vmap(end)(masses)))),
    "observed": jax.jit(jax.vmap(rate)),
    "many": of_many,
}
for name in sys.argv[1:]:
    result = np.asarray(calls[name](jax.device_put(alone, over_devices)))
    np.testing.assert_allclose(result, np.asarray(calls[name](jnp.asarray(alone))), rtol=1e-6, atol=1e-9, err_msg=name)
    print(name)
"""


def results_of(*calls):
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-W", "error", "-c", PROGRAM, *calls]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split("\n")[:-1]


def test_the_cache_and_the_compiler_see_over_how_many_devices_a_program_is_partitioned():
    """JAX has no public name for it: with another name both would take every program for one on one device."""
    seen = []
    looked = Primitive("looked")
    looked.def_abstract_eval(lambda x: x)

    def lowering(context, x):
        seen.append((several_devices.is_partitioned(context), private.n_devices(context)))
        return [x]

    mlir.register_lowering(looked, lowering)
    over_devices = NamedSharding(AbstractMesh((2,), ("run",)), PartitionSpec("run"))
    for sharding in (None, over_devices):
        example = jax.ShapeDtypeStruct((4,), jnp.float64, sharding=sharding)
        jax.jit(looked.bind).trace(example).lower(lowering_platforms=("cpu",))
    assert seen == [(False, 1), (True, 2)]


@pytest.mark.slow
def test_mapped_runs_on_two_devices():
    assert results_of("vmap") == ["vmap"]  # "INTERNAL: Failed to materialize symbols" before


@pytest.mark.slow
def test_every_way_on_two_devices():
    calls = "one", "jit", "gradient", "jit of a gradient", "observed", "many"
    assert results_of(*calls) == list(calls)
