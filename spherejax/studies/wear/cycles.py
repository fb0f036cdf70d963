"""Wear over many cycles: slow in the number of cycles, fast within one.

    h(N + dN) = h(N) + dN (r(h(N)) + r(h(N) + dN r(h(N))))/2,    r(h) = what one cycle wears off at depths h

Heun's method in N. A block of dN cycles deepens no place by more than a share of the clearance, and is made again,
shorter, where the rate changes by too much within it: on stiff foundations a block that wears off more than the bodies
approach each other would carve where they touch no more.

Source: Mukras, Kim, Sawyer, Jackson and Bergquist (2009), Numerical integration schemes and parallel computation for
wear prediction using finite element method, Wear 266:822-831, for blocks of cycles that are held short; Heun's
method and the control by the change of rate are of this library.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from spherejax.studies.wear.deposit import Maps

LARGEST_CHANGE = 0.2
"""By how much the rate may change within a block, as a share of its largest; beyond, the block is made again."""

MOST_BLOCKS = 2000


class Rate(NamedTuple):
    """What one cycle wears off.

    Attributes:
        depth: of both maps [m].
        approach: by how much farther than in the unworn joint the ball goes for the same load, the mean over the
            rubbing work [m].
        aside: resultant across the contact's direction over the force, the mean over the rubbing work.
        volume: k times the rubbing work, of socket and ball [m^3]; by itself, not by adding up the maps.
    """

    depth: Maps
    approach: float
    aside: float
    volume: tuple[float, float] = (0.0, 0.0)


class Worn(NamedTuple):
    """A state of wear.

    Attributes:
        cycles: N.
        depth: of both maps [m].
        rate: of a cycle from here.
        volume: rubbed off since the start, of socket and ball, added up beside the maps [m^3].
    """

    cycles: float
    depth: Maps
    rate: Rate
    volume: tuple[float, float] = (0.0, 0.0)


def over_cycles(
    rate: Callable[[Maps], Rate], start: Maps, cycles: float, largest_step: float
) -> tuple[list[Worn], str]:
    """States of wear from the first cycle to the last, and why it ended early; empty where it did not.

    Args:
        rate: what one cycle wears off at given depths.
        start: depths [m].
        cycles: how many.
        largest_step: by which a block may deepen any place of either map [m].
    """
    here = Worn(0.0, start, rate(start))
    found, block, tries = [here], np.inf, 0
    while here.cycles < cycles:
        fastest = _largest(here.rate.depth)
        if fastest == 0:
            here = here._replace(cycles=cycles)
            return [*found, here], ""
        left = cycles - here.cycles
        block = min(block, left, largest_step / fastest)
        tries += 1
        if tries > MOST_BLOCKS:
            return found, _stopped(here.cycles, cycles, block)
        tried = rate(_moved(here.depth, block, here.rate.depth))
        change = _largest(_moved(tried.depth, -1.0, here.rate.depth)) / fastest
        if change > LARGEST_CHANGE:
            block *= max(0.2, 0.8 * LARGEST_CHANGE / change)
            continue
        depth = _moved(_moved(here.depth, block / 2, here.rate.depth), block / 2, tried.depth)
        at = cycles if block == left else here.cycles + block
        socket, ball = (
            v + block / 2 * (first + last)
            for v, first, last in zip(here.volume, here.rate.volume, tried.volume, strict=True)
        )
        here = Worn(at, depth, rate(depth), (socket, ball))
        found.append(here)
        block *= min(2.0, 0.8 * LARGEST_CHANGE / max(change, 1e-3))
    return found, ""


def _largest(maps: Maps) -> float:
    return max(float(jnp.max(jnp.abs(each))) for each in maps)


def _moved(depth: Maps, step: float, by: Maps) -> Maps:
    return Maps(depth.socket + step * by.socket, depth.ball + step * by.ball)


def _stopped(at: float, cycles: float, block: float) -> str:
    return (
        f"after {MOST_BLOCKS} blocks {at:.6g} of {cycles:.6g} cycles were reached, the last in blocks of {block:.3g}: "
        "the foundation is stiff, and wears to a new shape within few of them. Ask for fewer cycles, or give a "
        "softer foundation="
    )
