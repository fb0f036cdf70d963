"""How many lanes a block has where nobody says: what a core's cache holds, or what an accelerator needs to be busy.

A core makes one step of all lanes in a time that is proportional to their number as long as they fit its first-level
cache, beside what a turn costs however many they are. On an accelerator a step costs its kernels' launches (some two
hundred, of six microseconds each on an H100) until all of its arithmetic units are busy, so that all runs side by side,
up to very many, take no longer than a few.
"""

from typing import Any

import jax

from spherejax.motion.integration.lanes import Block

ON_CPU = Block()
"""Three groups of eight, as machine code takes them. Of 250 four-bars, 64 lanes take 0.9 (dry) to 0.97 times (bushing,
film) as long; of 100 with sensitivities by one and three numbers 1.16 and 1.35 times, for they outgrow the cache and
idle at the end (`benchmarks/results/sweep_widths.csv`). A second, narrower loop for the end of a queue would take as
long to compile as the first. Without machine code the width makes no difference."""

ON_ACCELERATOR = Block(width=65_536, narrow=8_192)
"""About 9 kB a lane of a mechanism of three bodies with a method of 14 stages: 0.6 GB. On an H100 100,000 lanes make 27
times as many runs in a second as 1,000, and a million fewer than those (`benchmarks/results/sweep_lanes.csv`)."""


def block_for(platform: str | None = None) -> Block:
    """The block of lanes for a kind of device.

    Args:
        platform: as JAX calls it (`"cpu"`, `"gpu"`, `"tpu"`); that of the default device when None.
    """
    return ON_CPU if (platform or platform_of_runs()) == "cpu" else ON_ACCELERATOR


def platform_of_runs() -> str:
    """The platform that runs are made on."""
    chosen: Any = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        return jax.default_backend()
    return chosen if isinstance(chosen, str) else chosen.platform
