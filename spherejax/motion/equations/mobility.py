"""S = D M^-1 D^T, the accelerations of the constraints by unit multipliers, in blocks of joints that share a body."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.lanes import over_lanes, rows_at, sums_by_index
from spherejax.foundations.linear_algebra import BlockPattern, block_solve
from spherejax.motion.equations.body_motions import with_ground


class InverseMass(NamedTuple):
    """Inverse of the bodies' 6 x 6 blocks of the mass matrix.

    Attributes:
        of_translation: 1 / m [1/kg], shape (n_bodies,).
        of_rotation: inverse inertia in world axes [1/(kg m^2)], shape (n_bodies, 3, 3).
        in_body_axes: the same in the bodies' axes, where it is constant.
        rotations: A of each body.
    """

    of_translation: Float[Array, " b"]
    of_rotation: Float[Array, "b 3 3"]
    in_body_axes: Float[Array, "b 3 3"]
    rotations: Float[Array, "b 3 3"]

    def times(self, wrenches: Float[Array, "b 6"]) -> Float[Array, "b 6"]:
        """M^-1 times a wrench on each body."""
        return over_lanes(_inverse_mass_times, self, wrenches)

    def turned_times(self, wrenches: Float[Array, "b 6"]) -> Float[Array, "b 6"]:
        """As `times`, by way of the bodies' axes: for one wrench half of the operations that the matrix takes.

        So is its derivative, where the matrix's was a seventh of the operations of a four-bar's.
        """
        return over_lanes(_inverse_mass_turned_times, self, wrenches)


def _inverse_mass_times(mass: InverseMass, wrench: Float[Array, "6 *k"]) -> Float[Array, "6 *k"]:
    """One body's part; several wrenches as columns."""
    return jnp.concatenate([mass.of_translation * wrench[:3], mass.of_rotation @ wrench[3:]])


def _inverse_mass_turned_times(mass: InverseMass, wrench: Float[Array, "6"]) -> Float[Array, "6"]:
    moment = mass.rotations.T @ wrench[3:]
    return jnp.concatenate([mass.of_translation * wrench[:3], mass.rotations @ (mass.in_body_axes @ moment)])


class Mobility(NamedTuple):
    """S by its blocks. Joints of fewer equations than others are filled up with rows of the identity.

    Attributes:
        pattern: the pairs of joints that share a moving body.
        diagonal: block of each joint, shape (n_joints, n_rows, n_rows).
        pairs: block of each pair, shape (n_pairs, n_rows, n_rows).
    """

    pattern: BlockPattern
    diagonal: Float[Array, "k m m"]
    pairs: Float[Array, "e m m"]

    def solve(self, right: Float[Array, "k m"], smallest_pivot: float) -> Float[Array, "k m"]:
        """S^-1 times a vector given by joint."""
        return block_solve(self.pattern, self.diagonal, self.pairs, right, smallest_pivot)

    def with_larger_diagonal(self, share: float) -> "Mobility":
        """S with each diagonal entry enlarged by a share of itself."""
        return self._replace(diagonal=self.diagonal * (1 + share * jnp.eye(self.diagonal.shape[-1])))


def constraint_mobility(
    jacobians: Sequence[tuple[Float[Array, "n m 6"], Float[Array, "n m 6"]]],
    ends: tuple[tuple[int, int], ...],
    masses: InverseMass,
) -> Mobility:
    """Assemble the blocks that exist.

    Args:
        jacobians: D_i and D_j of the joints, kind after kind.
        ends: numbers of the two bodies of each joint, 0 for the ground.
        masses: inverse mass matrix.
    """
    width = max(first.shape[1] for first, _ in jacobians)
    padding = np.concatenate([np.tile(np.arange(width) >= f.shape[1], (f.shape[0], 1)) for f, _ in jacobians])
    D = jnp.concatenate([_filled_up(jnp.stack(blocks, 1), width) for blocks in jacobians])
    on_ends = jax.tree.map(lambda x: rows_at(with_ground(x), np.array(ends).ravel()), masses)
    by_end = D.reshape(-1, width, 6)
    weighted = over_lanes(_weighted, by_end, on_ends)
    diagonal = over_lanes(_own_block, D, weighted.reshape(D.shape), padding.astype(float))
    coupling = _coupling(ends)
    shared = over_lanes(_product, rows_at(by_end, coupling.left), rows_at(weighted, coupling.right))
    pairs = sums_by_index(shared, coupling.pair, len(coupling.pattern.pairs))
    return Mobility(coupling.pattern, diagonal, pairs)


def _filled_up(blocks: Float[Array, "n 2 m 6"], width: int) -> Float[Array, "n 2 width 6"]:
    return jnp.pad(blocks, ((0, 0), (0, 0), (0, width - blocks.shape[2]), (0, 0)))


def _weighted(block: Float[Array, "m 6"], mass: InverseMass) -> Float[Array, "m 6"]:
    """D_i M_i^-1."""
    return _inverse_mass_times(mass, block.T).T


def _own_block(blocks: Float[Array, "2 m 6"], weighted: Float[Array, "2 m 6"], is_filling) -> Float[Array, "m m"]:
    return blocks[0] @ weighted[0].T + blocks[1] @ weighted[1].T + jnp.diag(is_filling)


def _product(block: Float[Array, "m 6"], weighted: Float[Array, "m 6"]) -> Float[Array, "m m"]:
    return block @ weighted.T


class Coupling(NamedTuple):
    """Which joints share which bodies (static).

    Attributes:
        pattern: the pairs of joints, by number.
        left: for each body that two joints share, the first joint's end there, as 2 joint + (0 or 1).
        right: the second joint's end there.
        pair: the number of the pair.
    """

    pattern: BlockPattern
    left: Int[np.ndarray, " s"]
    right: Int[np.ndarray, " s"]
    pair: Int[np.ndarray, " s"]


@lru_cache(maxsize=256)
def _coupling(ends: tuple[tuple[int, int], ...]) -> Coupling:
    at_body: dict[int, list[int]] = {}
    for place, body in enumerate(end for pair in ends for end in pair):
        if body:
            at_body.setdefault(body, []).append(place)
    shared = sorted(
        (a // 2, b // 2, a, b) for places in at_body.values() for i, a in enumerate(places) for b in places[i + 1 :]
    )
    pairs = tuple(dict.fromkeys((i, j) for i, j, _, _ in shared))
    number = {pair: n for n, pair in enumerate(pairs)}
    columns = np.array([(a, b, number[i, j]) for i, j, a, b in shared], int).reshape(-1, 3)
    return Coupling(BlockPattern(len(ends), pairs), *columns.T)
