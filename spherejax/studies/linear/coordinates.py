"""Independent coordinates of a mechanism about a state: the tangent of its constraints, redundant ones included.

A small change (dq, dv, dm) of the state stays on the constraints Phi(t, q) = 0 and Phi' = D v + Phi_t = 0 where

    D dq = 0,    D dv + N dq = 0,    N = d(D v + Phi_t)/dq.

With the columns of P spanning the null space of D, orthonormal in the mass matrix (P^T M P = I), these changes are

    dq = P x,    dv = P u + V x,    V = -M^-1 D^T (D M^-1 D^T)^+ N P,

for any coordinates x [sqrt(kg) m] and u [sqrt(kg) m/s]: V is the least change of velocities, in kinetic energy, that
keeps the joints closed. Because P^T M V = 0, x = P^T M dq and u = P^T M dv. The rank of D is judged by the singular
values of D M^-1/2 with rows of unit length, as in `motion.redundancy`: equations that depend on others change nothing.

With B = [P, 0; V, P] and its left inverse B^+ = [P^T M, 0; 0, P^T M], the flow z' = J z of small changes becomes

    (x, u)' = B^+ (J B - B') (x, u).

B' follows the constraints along the motion, and P turns no more than it must (P^T M P' is symmetric). At rest B' = 0,
and about a steady motion in axes that turn with it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.motion.start.redundancy import DEPENDENT
from spherejax.studies.linear.tangent import Geometry


class Coordinates(NamedTuple):
    """Independent coordinates about a state.

    Attributes:
        mass: M, shape (6 n, 6 n).
        free: P, shape (6 n, f).
        following: V, shape (6 n, f).
        least: M^-1 D^T (D M^-1 D^T)^+, shape (6 n, c): the least change for a residual of the constraints.
        n_memory: memory entries.
    """

    mass: Float[np.ndarray, "n_v n_v"]
    free: Float[np.ndarray, "n_v f"]
    following: Float[np.ndarray, "n_v f"]
    least: Float[np.ndarray, "n_v c"]
    n_memory: int

    @property
    def degrees_of_freedom(self) -> int:
        """f."""
        return self.free.shape[1]

    @property
    def basis(self) -> Float[np.ndarray, "n_z n_x"]:
        """Changes of the state by coordinates (x, u, m)."""
        return _stacked(self.free, self.following, self.free, np.eye(self.n_memory))

    @property
    def inverse(self) -> Float[np.ndarray, "n_x n_z"]:
        """Coordinates by changes of the state that keep to the constraints, of others by projection."""
        by = self.free.T @ self.mass
        return _stacked(by, np.zeros_like(by), by, np.eye(self.n_memory))

    def turned(self, at: Geometry, along: Geometry, turning: Float[np.ndarray, "3"]) -> np.ndarray:
        """How `basis` follows the motion, in axes that turn.

        With R the rotation of the axes, D is D R in them and M is R^T M R. Directions that the constraints leave free
        follow these, and do not turn among each other.

        Args:
            at: constraints and masses.
            along: their derivatives along the motion, world axes.
            turning: angular velocity of the axes [rad/s].
        """
        x, y, z = turning
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        n = len(self.mass) // 6
        turn = np.kron(np.eye(2 * n), cross)
        D, N = np.asarray(at.by_position) @ turn, np.asarray(at.rate_by_position) @ turn
        each = np.kron(np.eye(2), cross)
        masses = np.asarray(at.mass) @ each - each @ np.asarray(at.mass)
        seen = Geometry(along.mass + masses, None, None, along.by_position + D, along.rate_by_position + N)
        return self.slopes(at, seen, 0.0)[0]

    def slopes(self, at: Geometry, along: Geometry, size: float) -> tuple[np.ndarray, np.ndarray]:
        """How `basis` and `inverse` follow the constraints along a change of numbers.

        Args:
            at: constraints and masses.
            along: their derivatives by a number.
            size: of the number.

        Raises:
            SceneError: where redundant equations contradict each other after the change.
        """
        P, V, M = self.free, self.following, self.mass
        D, N = np.asarray(at.by_position), np.asarray(at.rate_by_position)
        dM, dD, dN = _joined(along.mass), np.asarray(along.by_position), np.asarray(along.rate_by_position)
        dP = -self.least @ (dD @ P) - P @ (P.T @ dM @ P) / 2
        missing = np.abs(D @ dP + dD @ P).max(initial=0.0)
        if missing > CONTRADICTORY * np.abs(dD @ P).max(initial=0.0) and missing * size > ROUNDING * np.abs(D).max():
            raise SceneError(
                "the number changes how many of the constraint equations are independent: redundant joints hold only "
                "as they are. Take a number that does not move them, or leave out the redundant joint"
            )
        dV = -self.least @ (dD @ V + dN @ P + N @ dP) - P @ (dP.T @ M @ V + P.T @ dM @ V)
        by = dP.T @ M + P.T @ dM
        none = np.zeros((self.n_memory, self.n_memory))
        return _stacked(dP, dV, dP, none), _stacked(by, np.zeros_like(by), by, none)


CONTRADICTORY = 1e-6
"""Share of a change of redundant constraints that may be left over; geometry closed to 1e-9 leaves less."""

ROUNDING = 1e-10
"""What is left over of a change of constraints by as much as the number itself, as a share of D, that is rounding."""


def coordinates_of(found: Geometry, n_memory: int) -> Coordinates:
    """Independent coordinates from constraints and masses at a state."""
    D, M = np.asarray(found.by_position), _joined(found.mass)
    root = np.linalg.cholesky(M)
    weighted = np.linalg.solve(root, D.T).T
    lengths = np.linalg.norm(weighted, axis=1)
    lengths = np.where(lengths > 0, lengths, 1.0)
    left, sizes, right = np.linalg.svd(weighted / lengths[:, None], full_matrices=True)
    rank = int(np.sum(sizes > DEPENDENT * sizes[0])) if sizes.size else 0
    back = np.linalg.solve(root.T, right.T)
    least = back[:, :rank] @ (left[:, :rank] / sizes[:rank]).T / lengths
    free = back[:, rank:]
    return Coordinates(M, free, -least @ (np.asarray(found.rate_by_position) @ free), least, n_memory)


def _joined(blocks) -> np.ndarray:
    """6 x 6 blocks along the diagonal."""
    blocks = np.asarray(blocks)
    n = len(blocks)
    whole = np.zeros((n, 6, n, 6))
    whole[np.arange(n), :, np.arange(n), :] = blocks
    return whole.reshape(6 * n, 6 * n)


def _stacked(first: np.ndarray, below: np.ndarray, second: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """[first, 0, 0; below, second, 0; 0, 0, memory]."""
    (n, m), k = first.shape, len(memory)
    whole = np.zeros((2 * n + k, 2 * m + k))
    whole[:n, :m], whole[n : 2 * n, :m], whole[n : 2 * n, m : 2 * m] = first, below, second
    whole[2 * n :, 2 * m :] = memory
    return whole
