"""Arrays that are sharded over several devices give what arrays on one device give."""

import os
import subprocess
import sys

import pytest

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


@pytest.mark.slow
def test_mapped_runs_on_two_devices():
    assert results_of("vmap") == ["vmap"]  # "INTERNAL: Failed to materialize symbols" before


@pytest.mark.slow
def test_every_way_on_two_devices():
    calls = "one", "jit", "gradient", "jit of a gradient", "observed", "many"
    assert results_of(*calls) == list(calls)
