"""Scenes drawn at random finish or explain, and obey energy, momentum, constraints and walls; seeds are printed."""

import numpy as np
import pytest
import random_scenes
from random_scenes import compiled, faults, in_lanes, mapped, stacked, structure

import spherejax as sj

FEW = (1, 3, 13, 17)
"""A ball on a torsion spring, a tyre, a cylinder on a plane, a free pair whose ball starts in flight."""

MANY = tuple(seed for seed in range(60) if len(structure(seed).links) <= 2)[:36]
RTOLS = (1e-6, 1e-8)


def group(seed: int, n: int):
    """Structure, numbers, times and tolerance of a structure's seed."""
    values = stacked(structure(seed), range(n))
    lasts = random_scenes.duration({"length": values["length"][0]})
    return structure(seed), values, np.linspace(0.0, lasts, random_scenes.N_SAMPLES), RTOLS[seed % 2]


def one_of(values, k: int):
    return {key: value[k] for key, value in values.items()}


def all_faults(seed: int, n: int) -> list[str]:
    made, values, ts, rtol = group(seed, n)
    runs = [compiled(made, one_of(values, k), ts, rtol) for k in range(n)]
    found = [
        f"structure {seed} numbers {k}: {fault}"
        for k, run in enumerate(runs)
        for fault in faults(made, one_of(values, k), ts, rtol, run)
    ]
    if not any(run["status"] == sj.Status.SUCCEEDED for run in runs):
        found.append(f"structure {seed}: no run of {n} succeeds")
    return found


@pytest.mark.parametrize("seed", FEW)
def test_scenes_are_sound_or_explained(seed):
    found = all_faults(seed, 25)
    assert not found, "\n".join(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MANY)
def test_many_scenes_are_sound_or_explained(seed):
    found = all_faults(seed, 28)
    assert not found, "\n".join(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 7])
def test_jit_vmap_and_lanes_agree(seed):
    """Of structures whose motion no impact makes chaotic over so short a time, as far as they succeed."""
    made, values, ts, rtol = group(seed, 4)
    singles = [compiled(made, one_of(values, k), ts, rtol) for k in range(4)]
    for way in (mapped, in_lanes):
        many = way(made, values, ts, rtol)
        for k, single in enumerate(singles):
            assert many["status"][k] == single["status"] == sj.Status.SUCCEEDED
            scale = np.abs(single["ys"]).max()
            np.testing.assert_allclose(many["ys"][k], single["ys"], atol=1e3 * rtol * scale, err_msg=f"numbers {k}")


@pytest.mark.parametrize(
    ("key", "change", "fault"),
    [
        ("energy", lambda x: x + np.linspace(0, 1, x.size) * (1 + abs(x[0])), "of the energy in motion"),
        ("norm", lambda x: x + 0.1, "quaternion norm"),
        ("violation", lambda x: x + 1.0, "constraints violated"),
        ("through", lambda x: x + 2.8, "through the wall"),
        ("linear", lambda x: x + np.linspace(0, 1e3, len(x))[:, None], "linear momentum"),
        ("ys", lambda x: np.where(np.arange(len(x))[:, None] > 5, np.nan, x), "NaN"),
    ],
)
def test_each_fault_is_found(key, change, fault):
    made, values, ts, rtol = group(7, 1)
    run = compiled(made, one_of(values, 0), ts, rtol)
    spoilt = {**run, key: change(run[key])}
    assert any(fault in text for text in faults(made, one_of(values, 0), ts, rtol, spoilt))
