"""Positions that a start cannot keep: bodies that are moved far for the joints to close are named aloud.

Newton's method closes a mechanism from far away too, but then in another branch, or with a misplaced body where nobody
put it. Small corrections, of printed digits, pass without a word.
"""

import math
from functools import lru_cache

import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Scalar
from spherejax.model.picking import picked
from spherejax.model.system import Structure, System
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import Assembly, assembly_residuals, described_state
from spherejax.motion.start.tolerances import SMALLEST_LENGTH
from spherejax.motion.start.velocities import MOST_NAMED

FAR_SHARE = 2e-3
"""Bodies are moved far from this share of the largest body's size on. Tables of three digits leave up to 1e-3 of it, of
four 1e-4 (those of the four-bar 3e-5); what is misplaced by a hundredth, or in another branch, is said."""

PRINTED_SHARE = 1e-4
"""What is below this share of the largest body's size is taken for the rounding of printed tables."""

CLEARANCE_SHARE = 0.5
"""In a joint with clearance a change of this share of it is far: the ball would be elsewhere in its socket."""

FAR_TURNED = 5e-3
"""Bodies are turned far from this angle on [rad]; quaternions of three digits leave up to 2e-3."""


def far_distance(system: System, structure: Structure, numbers: np.ndarray) -> float:
    """From where on a body is moved far [m]: half the smallest clearance, within 1e-4 and 2e-3 of the largest body.

    Args:
        system: the system; clearances that are traced are not looked at.
        structure, numbers: the system as if its joints were ideal, taken apart; the numbers are known.
    """
    smallest = min((float(c) for c in clearances_of(system) if is_concrete(c)), default=np.inf)
    return far_from(largest_body(structure, numbers), smallest)


def clearances_of(system: System) -> list:
    """Of all joints with a model [m]; infinite without."""
    models = [getattr(joint, "model", None) for joint in system.joints.values()]
    return [getattr(model, "clearance", np.inf) for model in models]


def far_from(size: float, smallest: float) -> float:
    """The same, by the size of the largest body and the smallest clearance [m]."""
    if size == SMALLEST_LENGTH and np.isfinite(smallest):
        return CLEARANCE_SHARE * smallest
    return float(np.clip(CLEARANCE_SHARE * smallest, PRINTED_SHARE * size, FAR_SHARE * size))


def largest_body(structure: Structure, numbers: np.ndarray) -> float:
    """The size of the largest body [m]; masses, which do not enter it, are left out where it is remembered."""
    places = _places_at(structure)
    if places is not None:
        numbers = np.where(places, numbers, 0.0)
    return _largest_body(structure, numbers.tobytes())


@lru_cache(maxsize=64)
def _places_at(structure: Structure) -> np.ndarray | None:
    """Where places of joints are among the numbers; None where joints have others than they hold."""
    points = picked(lambda system: [joint.points for joint in system.joints.values()], structure)
    return None if points is None else points.among(sum(map(math.prod, structure.shapes)))


@lru_cache(maxsize=64)
def _largest_body(structure: Structure, numbers: bytes) -> float:
    """Kept, as the start itself: it takes longer than all else that is looked at in a start that was met before."""
    geometry = structure.system(np.frombuffer(numbers))
    return max(SMALLEST_LENGTH, *(_size(geometry, name) for name in geometry.bodies))


def _size(geometry: System, name: str) -> float:
    """The largest distance between the places of joints on a body, its center of mass among them [m]."""
    joints = geometry.joints.values()
    places = [joint.points[joint.bodies.index(name)] for joint in joints if name in joint.bodies]
    points = np.array([np.zeros(3), *(np.asarray(place) for place in places)])
    return float(np.linalg.norm(points[:, None] - points, axis=-1).max())


def moved_bodies(system: System, structure: Structure, numbers, t: float, start: Assembly) -> str:
    """What to say of a start whose bodies are not where the scene puts them; nothing where they nearly are.

    What drivers ask for is not looked at while the other joints close: that is how a driven mechanism is put where its
    motion begins.

    Args:
        system: the system.
        structure, numbers: the system as if its joints were ideal, taken apart; the numbers are known.
        t: time of the start [s].
        start: the consistent start.
    """
    moved, turned = np.asarray(start.displacement), np.asarray(start.rotation)
    far = far_distance(system, structure, numbers)
    shares = shares_of(moved, turned, far)
    if not shares.max(initial=0.0) > 1:
        return ""
    geometry = structure.system(numbers)
    gaps = program_for(gaps_described, structure).compute(numbers, t, np.zeros(geometry.layout.size))
    size_of = {name: float(np.abs(gap).max()) for name, gap in gaps.items() if not geometry.joints[name].is_driven}
    if system.is_driven and not max(size_of.values(), default=0.0) > far:
        return ""
    worst = max(size_of, key=lambda name: size_of[name])
    remedy = (
        f"Joint {worst!r} gapes most there ({size_of[worst]:.3g} m or rad). Give positions and quaternions that close "
        "the joints, e.g. those taken: run.position(body)[0] and run.quaternion(body)[0]"
    )
    if system.joints[worst].answers_with_force:
        remedy += "; or, for a ball or bushing that starts away from its center, give the joint starts_concentric=False"
    return (
        f"where the bodies are described the joints do not close, and the bodies were moved: "
        f"{_listed(list(system.bodies), moved, turned, shares)}. {remedy}."
    )


def shares_of(moved: np.ndarray, turned: np.ndarray, far: float) -> np.ndarray:
    """How far bodies were moved [m] and turned [rad], as shares of what counts as far."""
    return np.maximum(moved / far, turned / FAR_TURNED)


def gaps_described(system: System, t: Scalar, y) -> dict:
    """Residuals of the joints that the start must satisfy, where the scene puts the bodies [m or 1]."""
    del y
    return assembly_residuals(system, t, described_state(system))


def _listed(names: list[str], moved: np.ndarray, turned: np.ndarray, shares: np.ndarray) -> str:
    """The bodies that were moved far, the farthest first, and how far each."""
    order = [i for i in np.argsort(-shares, kind="stable") if shares[i] > 1]
    shown = ", ".join(f"{names[i]!r} by {_short(moved, i)} m and {_short(turned, i)} rad" for i in order[:MOST_NAMED])
    more = len(order) - MOST_NAMED
    return shown + (f" and {more} more" if more > 0 else "")


def _short(sizes: np.ndarray, i: int) -> str:
    """Two digits of one of them; rounding is nothing."""
    return f"{sizes[i]:.2g}" if sizes[i] > 1e-12 else "0"
