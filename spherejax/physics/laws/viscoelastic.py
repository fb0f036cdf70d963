"""What rubber does besides spring and damper: it relaxes (Maxwell branches), and it rubs inside (Berg's friction).

Both stand beside any elastomer of a bushing and remember: their states are deflections, as seen by an observer on the
socket, in its axes. So a pair that turns as one rigid body feels nothing new, whatever the states are.
"""

from typing import Annotated, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative, numeric, positive
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Matrix3, Number, Numeric, Scalar, Shaped, Unit, Vector3
from spherejax.physics.bodies import numbers
from spherejax.physics.laws.base import AbstractLaw

OfBranches = Annotated[Numeric, Shaped(((), (-1,)))]
"""One number for each branch; a number alone is one branch."""

OfBranchesAlongAxes = Annotated[Numeric, Shaped(((), (-1,), (-1, 3)))]
"""One number for each branch, or three along the socket's axes."""

AlongAxes = Annotated[Numeric, Shaped(((), (3,)))]
"""One number for all directions, or three along the socket's axes."""

Branches = Float[Array, "n 3"]
"""Deflections of the branches' springs, socket axes [m], or their turns [rad]."""


class Maxwell(AbstractLaw):
    """Relaxation: springs in series with dampers, any number of such branches beside an elastomer.

        f = -sum_k k_k e_k,    e_k_rate = e_rate - e_k/tau_k

    e_k is the deflection of the spring of branch k, e_rate the rate of the bushing's deflection, both in axes that turn
    with the socket; the damper of the branch is k_k tau_k. A branch is a spring for what is faster than tau_k, and
    nothing for what is slower: in harmonic motion it adds k_k i w tau_k/(1 + i w tau_k) to the stiffness of the
    elastomer, which is what remains in the end.

    Attributes:
        stiffness: k_k of each branch, shape (n,), or along the socket's axes, shape (n, 3) [N/m].
        time: tau_k of each branch, shape (n,) [s].
        rotational_stiffness: of each branch against rotation, shape (n,) or (n, 3), or `None` [N m/rad].

    A number instead of a list is one branch. Branches start relaxed, e_k = 0: what the bushing bears at the start, it
    has borne for long. They store sum_k k_k e_k.e_k/2 and dissipate sum_k k_k e_k.e_k/tau_k, which is never negative.

    Against rotation a branch adds the moment -B^T k_k theta_k with theta_k_rate = B w - theta_k/tau_k. w is the angular
    velocity of the ball against the socket, in its axes; B selects what the elastomer resists: all of it, the tilt of a
    hinge, the middle turn of a cross. theta_k stores and dissipates as e_k does at any angle; it is the rotation since
    about tau_k ago where that is small or about one axis.

    Limits: tau_k to infinity makes a spring of k_k from the start, k_k to infinity with k_k tau_k = d a damper of d.

    Source: the generalised Maxwell model (Wiechert), e.g. Ferry (1980), Viscoelastic Properties of Polymers, ch. 1.
    """

    never_adds_energy: ClassVar[bool] = True

    stiffness: Annotated[OfBranchesAlongAxes, Unit("N/m")]
    time: Annotated[OfBranches, Unit("s")]
    rotational_stiffness: Annotated[OfBranchesAlongAxes | None, Unit("N m/rad")] = None

    def __init__(
        self,
        stiffness: Annotated[OfBranchesAlongAxes, Unit("N/m")],
        time: Annotated[OfBranches, Unit("s")],
        rotational_stiffness: Annotated[OfBranchesAlongAxes | None, Unit("N m/rad")] = None,
    ):
        self.stiffness = _listed(stiffness)
        self.time = _listed(time)
        self.rotational_stiffness = None if rotational_stiffness is None else _listed(rotational_stiffness)

    @property
    def n_branches(self) -> int:
        """How many branches there are (static)."""
        return np.shape(self.time)[0]

    def rates(self, branches: Branches, rate: Vector3) -> Branches:
        """e_k_rate = e_rate - e_k/tau_k, of deflections [m/s] or turns [rad/s] alike."""
        return rate - branches / jnp.asarray(self.time)[:, None]

    def force(self, branches: Branches) -> Vector3:
        """-sum_k k_k e_k [N]."""
        return -jnp.sum(_along_axes(self.stiffness) * branches, 0)

    def moment(self, branches: Branches) -> Vector3:
        """-sum_k k_k theta_k [N m], before B^T."""
        return -jnp.sum(_along_axes(self.rotational_stiffness) * branches, 0)

    def elastic_energy(self, branches: Branches) -> Scalar:
        """sum_k k_k e_k.e_k/2 [J]."""
        return 0.5 * jnp.sum(_along_axes(self.stiffness) * branches * branches)

    def rotational_energy(self, branches: Branches) -> Scalar:
        """sum_k k_k theta_k.theta_k/2 [J]."""
        return 0.5 * jnp.sum(_along_axes(self.rotational_stiffness) * branches * branches)

    def requirements(self) -> list[Requirement]:
        """A time above zero for each branch, and stiffnesses that are not negative, as many."""
        n = np.shape(self.time)[0] if np.ndim(self.time) == 1 else 0
        is_list = Requirement(
            "time",
            self.time,
            n > 0,
            "be a list of one or more numbers",
            "Give a relaxation time for each branch, e.g. time=[0.1, 0.01].",
        )
        times = [positive("time", self.time, "s")] if n else []
        given = {"stiffness": (self.stiffness, "N/m"), "rotational_stiffness": (self.rotational_stiffness, "N m/rad")}
        found = [is_list, *times]
        for field, (value, unit) in given.items():
            if value is not None:
                fits = np.shape(value) in ((n,), (n, 3))
                expected = f"have one number, or three along the axes, for each of the {n} times"
                remedy = f"Give as many stiffnesses as times [{unit}]."
                found.append(Requirement(field, value, fits, expected, remedy))
                found += [non_negative(field, value, unit)] if fits else []
        return found


class Berg(AbstractLaw):
    """Friction inside filled rubber, which makes it stiffer for small amplitudes, at any frequency.

        f = -F_max z/x_2,    z_rate = v - (z/x_2) (2 |v| - z.v/x_2)

    v is the rate of the bushing's deflection, z its deflection as friction remembers it, both in axes that turn with
    the socket. Along a line the force F = F_max z/x_2 against the motion follows

        dF/dx = (F_max/x_2) (1 - F/F_max)^2  as x rises,    (F_max/x_2) (1 + F/F_max)^2  as x falls

    Attributes:
        limit: F_max, the largest friction force, or three along the socket's axes [N].
        half_length: x_2, the deflection from rest at which half of it acts [m].
        rotational_limit: the largest friction moment, one or three along the axes, or `None` [N m].
        half_angle: the rotation from rest at which half of it acts [rad].

    Relation to Berg's law. His force runs from a reference (x_s, F_s), which moves to each turning point, as
    F = F_s + (x - x_s)/(x_2 (1 - mu) + x - x_s) (F_max - F_s), mu = F_s/F_max, while x rises, and alike with -F_max for
    F_max while it falls. That is the law above with its right side divided by (1 - mu)^2. So both are one curve from
    rest (mu = 0), with F_max/2 at x_2; they have the same limit, and for small amplitudes x_0 the same stiffness
    F_max/x_2 and loss per cycle (8/3) F_max x_0^3/x_2^2. But his needs the turning points, which are events. Without
    them the loop of an amplitude r = x_0/x_2 reaches F_max (sqrt(1 + 4 r^2) - 1)/(2 r), where his reaches
    F_max (sqrt(1 + 6 r + r^2) - 1 - r)/2: at r = 1, 0.62 and 0.41 of the limit; softer by r^2 for small r, his by
    2 r. Parameters found for one form are not those of the other: fit them anew.

    It is the model of Dahl with the exponent 2; the vector form keeps |z| <= x_2. Stored is (F_max/x_2) z.z/2,
    dissipated (F_max/x_2^2) z.z (2 |v| - z.v/x_2), which is never negative. Nothing depends on speed: the force follows
    the path alone. Friction starts at z = 0. In a direction whose limit is zero nothing slides.

    Limits: at v = 0 the derivative of |v| is taken as 0. half_length to 0 makes dry friction of F_max.

    Source: Berg (1998), Vehicle System Dynamics 30:197-212, for the law with turning points; Dahl (1976), AIAA J.
    14:1675-1682, for friction as a rate; the relation and the vector form are derived here.
    """

    never_adds_energy: ClassVar[bool] = True

    limit: Annotated[AlongAxes, Unit("N")]
    half_length: Annotated[Number, Unit("m")]
    rotational_limit: Annotated[AlongAxes | None, Unit("N m")] = None
    half_angle: Annotated[Number | None, Unit("rad")] = None

    def __init__(
        self,
        limit: Annotated[AlongAxes, Unit("N")],
        half_length: Annotated[Number, Unit("m")],
        rotational_limit: Annotated[AlongAxes | None, Unit("N m")] = None,
        half_angle: Annotated[Number | None, Unit("rad")] = None,
    ):
        if (rotational_limit is None) != (half_angle is None):
            raise TypeError("rotational_limit= and half_angle= belong together: give both or neither")
        self.limit = numbers(limit)
        self.half_length = half_length
        self.rotational_limit = None if rotational_limit is None else numbers(rotational_limit)
        self.half_angle = half_angle

    def rate(self, bristle: Vector3, deflection_rate: Vector3) -> Vector3:
        """z_rate [m/s].

        Args:
            bristle: z, socket axes [m].
            deflection_rate: v, socket axes [m/s].
        """
        return _sliding(bristle, deflection_rate, self.limit, self.half_length)

    def force(self, bristle: Vector3) -> Vector3:
        """-F_max z/x_2 [N]."""
        return -self.limit * bristle / self.half_length

    def elastic_energy(self, bristle: Vector3) -> Scalar:
        """(F_max/x_2) z.z/2 [J]."""
        return 0.5 * jnp.sum(self.limit * bristle * bristle) / self.half_length

    def rotational_rate(self, bristle: Vector3, rotation_rate: Vector3) -> Vector3:
        """The same for rotation [rad/s]: z in rad, v = B w."""
        assert self.half_angle is not None
        return _sliding(bristle, rotation_rate, self.rotational_limit, self.half_angle)

    def moment(self, bristle: Vector3) -> Vector3:
        """The friction moment before B^T [N m]."""
        assert self.rotational_limit is not None
        assert self.half_angle is not None
        return -self.rotational_limit * bristle / self.half_angle

    def rotational_energy(self, bristle: Vector3) -> Scalar:
        """Stored by rotation [J]."""
        assert self.rotational_limit is not None
        assert self.half_angle is not None
        return 0.5 * jnp.sum(self.rotational_limit * bristle * bristle) / self.half_angle

    def requirements(self) -> list[Requirement]:
        """Limits that are not negative, lengths above zero."""
        found = [_limit_requirement("limit", self.limit, "N"), positive("half_length", self.half_length, "m")]
        if self.rotational_limit is not None:
            found.append(_limit_requirement("rotational_limit", self.rotational_limit, "N m"))
            found.append(positive("half_angle", self.half_angle, "rad"))
        return found


def _sliding(bristle: Vector3, rate: Vector3, limit, half: Number) -> Vector3:
    """v - (z/x_2) (2 |v| - z.v/x_2), with v only along axes that rub."""
    v = jnp.where(jnp.asarray(limit) > 0, rate, 0.0)
    return v - bristle / half * (2.0 * safe_norm(v) - (bristle @ v) / half)


def _limit_requirement(field: str, value, unit: str) -> Requirement:
    if np.shape(value) not in ((), (3,)):
        remedy = f"Give one number, or three along the socket's axes [{unit}]."
        return Requirement(field, value, False, "be one number or three", remedy)
    return non_negative(field, value, unit)


def _listed(value):
    """Numbers for each branch; one alone is a list of one."""
    value = numbers(value)
    return value.reshape(1) if hasattr(value, "reshape") and np.ndim(value) == 0 else value


def _along_axes(stiffness) -> Float[Array, "n 1"] | Branches:
    """Stiffness of each branch along the axes, or alike in all directions."""
    stiffness = jnp.asarray(stiffness)
    return stiffness if stiffness.ndim == 2 else stiffness[:, None]


def free_directions(stiffness: Matrix3, damping: Matrix3):
    """Along which of the socket's axes neither a spring nor a damper acts: a joint slides there, shape (3,)."""
    K, D = numeric(stiffness), numeric(damping)
    return (abs(K).sum(0) == 0) & (abs(D).sum(0) == 0)
