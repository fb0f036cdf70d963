"""Arrays that lie on several devices are refused with a remedy, where they are seen."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import jax, numpy as np, spherejax as sj
from jax.sharding import Mesh, NamedSharding, PartitionSpec
spread = NamedSharding(Mesh(np.array(jax.devices()), ("run",)), PartitionSpec("run"))
masses = jax.device_put(np.linspace(1.0, 2.0, 4), spread)
try:
    sj.simulate_many(lambda mass: sj.gallery.physical_pendulum(mass=mass), {"mass": masses}, np.linspace(0.0, 0.1, 3))
except sj.SceneError as error:
    print(error)
"""


@pytest.mark.slow
def test_parameters_of_many_runs_on_two_devices():
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=True)
    assert "on 2 devices" in found.stdout
    assert "np.asarray" in found.stdout
