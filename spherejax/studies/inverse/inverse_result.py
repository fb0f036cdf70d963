"""What inverse dynamics answers."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.studies.inverse.balance import NOT_UNIQUE, Balance
from spherejax.studies.inverse.kinematics import Misfit, Motion
from spherejax.studies.inverse.mechanism import IdealMechanism

if TYPE_CHECKING:
    import xarray


class InverseWarning(UserWarning):
    """A motion that the motors cannot make, or that leaves something open."""


class InverseDynamics(eqx.Module):
    """Efforts of motors and reactions of joints that make a motion; see `inverse_dynamics`.

    It is a pytree: it can be returned from `jax.jit` and `jax.vmap`.

    Attributes:
        ts: instants [s], shape (n,).
        motion: poses, velocities and accelerations of all bodies.
        balance: the forces.
        misfit: how far the motion is from what the joints ask for and from what was measured.
        mechanism: the scene as it was seen: every joint ideal.
    """

    ts: Float[Array, " n"]
    motion: Motion
    balance: Balance
    misfit: Misfit
    mechanism: IdealMechanism

    def __repr__(self) -> str:
        if not is_concrete(self.ts) or np.ndim(self.ts) != 1:
            return "InverseDynamics(traced, or many)"
        efforts = [f"{name} [{self.unit(name)}]" for name in self.motors]
        left = self.largest_unbalanced
        lines = [
            f"Inverse dynamics at {len(self.ts)} instants: efforts of {', '.join(efforts) or 'no motor'}; reactions of "
            f"{', '.join(self.joints) or 'no joint'}; at most {left:.1e} N (moments over {self.length:.3g} m) are "
            "carried by neither"
        ]
        if self.not_unique:
            lines.append(f"not unique, the least ones are shown: {', '.join(self.not_unique)}")
        return "\n".join(lines)

    @property
    def motors(self) -> tuple[str, ...]:
        """Names of the motors."""
        return self.mechanism.motors

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that have reactions."""
        return tuple(self.balance.reactions)

    def effort(self, motor: str) -> Float[Array, "n ..."]:
        """What a motor exerts along its coordinate [N or N m], shape (n,).

        Of a driver it is as `Trajectory.driving_effort`: of one that prescribes several numbers, shape (n, k).
        """
        effort = _named(self.balance.efforts, motor, "motor")
        return effort[..., 0] if effort.shape[-1] == 1 else effort

    def power(self, motor: str) -> Float[Array, " n"]:
        """Power that a motor puts into the mechanism [W]."""
        return _named(self.balance.powers, motor, "motor")

    def unit(self, motor: str) -> str:
        """Unit of an effort."""
        if motor in self.mechanism.coordinates:
            return self.mechanism.coordinates[motor].part_units["effort"]
        return self.mechanism.system.joints[motor].effort_unit

    def reaction(self, joint: str) -> Float[Array, "n 3"]:
        """Force of a joint on its second body (of a spherical joint: the ball's), world axes [N]."""
        return _named(self.balance.reactions, joint, "joint")[..., :3]

    def reaction_moment(self, joint: str) -> Float[Array, "n 3"]:
        """Moment of a joint on its second body, about the joint's point there, world axes [N m]."""
        return _named(self.balance.reactions, joint, "joint")[..., 3:]

    def position(self, body: str) -> Float[Array, "n 3"]:
        """Center of mass of a body, world axes [m]."""
        return self.motion.pose[..., self._body(body), :3]

    def quaternion(self, body: str) -> Float[Array, "n 4"]:
        """Orientation of a body, unit quaternion, scalar first."""
        return self.motion.pose[..., self._body(body), 3:]

    def velocity(self, body: str) -> Float[Array, "n 3"]:
        """Velocity of a body's center of mass, world axes [m/s]."""
        return self.motion.velocities[..., self._body(body), :3]

    def angular_velocity(self, body: str) -> Float[Array, "n 3"]:
        """Angular velocity of a body, world axes [rad/s]."""
        return self.motion.velocities[..., self._body(body), 3:]

    def acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Acceleration of a body's center of mass, world axes [m/s^2]."""
        return self.motion.accelerations[..., self._body(body), :3]

    def angular_acceleration(self, body: str) -> Float[Array, "n 3"]:
        """Angular acceleration of a body, world axes [rad/s^2]."""
        return self.motion.accelerations[..., self._body(body), 3:]

    def unbalanced(self, body: str) -> Float[Array, "n 6"]:
        """Force [N] and moment about the center of mass [N m] that a body's motion asks for and nothing exerts.

        Zero to rounding of a motion that the motors can make. Of a measured one it is what noise, wrong masses or a
        force that the scene does not have leave open, in the least squares of forces and of moments over L.
        """
        return self.balance.unbalanced[..., self._body(body), :]

    @property
    def largest_unbalanced(self) -> float:
        """The largest of all of them [N], moments over the mechanism's length."""
        left = np.abs(np.asarray(self.balance.unbalanced))
        return float(np.max(np.concatenate([left[..., :3], left[..., 3:] / self.length], -1), initial=0.0))

    @property
    def not_unique(self) -> tuple[str, ...]:
        """Motors, and joints with "force" or "moment", whose share the motion does not determine at some instant.

        More motors than degrees of freedom leave efforts open, redundant constraints reactions. Those shown are the
        least ones, see `inverse_dynamics`. For known numbers.
        """
        names = [name for name, free in self.balance.free_efforts.items() if np.max(free) > NOT_UNIQUE]
        for name, free in self.balance.free_reactions.items():
            for kind, share in zip(("force", "moment"), np.max(np.reshape(free, (-1, 2)), 0), strict=True):
                if share > NOT_UNIQUE:
                    names.append(f"{name} ({kind})")
        return tuple(names)

    def to_xarray(self) -> "xarray.Dataset":
        """Efforts, powers, reactions and what is unbalanced, labelled and with units."""
        import xarray

        if np.ndim(self.ts) != 1:
            raise SceneError("to_xarray takes one motion; take one lane of many first")
        axes = {"time": np.asarray(self.ts), "axis": ["x", "y", "z"], "joint": list(self.joints)}
        axes |= {"body": list(self.mechanism.system.bodies)}
        columns = {}
        for name in self.motors:
            effort = np.asarray(self.effort(name))
            dims = ("time",) if effort.ndim == 1 else ("time", "axis")
            columns[f"{name}.effort"] = (dims, effort, {"units": self.unit(name)})
            columns[f"{name}.power"] = (("time",), np.asarray(self.power(name)), {"units": "W"})
        reactions = np.stack([np.asarray(x) for x in self.balance.reactions.values()], 1) if self.joints else None
        left = np.asarray(self.balance.unbalanced)
        for i, (kind, unit) in enumerate((("force", "N"), ("moment", "N m"))):
            part = slice(3 * i, 3 * i + 3)
            if reactions is not None:
                name = "reaction" if kind == "force" else "reaction_moment"
                columns[name] = (("time", "joint", "axis"), reactions[..., part], {"units": unit})
            columns[f"unbalanced_{kind}"] = (("time", "body", "axis"), left[..., part], {"units": unit})
        return xarray.Dataset(columns, axes, {"not_unique": list(self.not_unique)})

    @property
    def length(self) -> float:
        """L [m], over which moments count as forces."""
        return float(np.max(np.asarray(self.mechanism.length)))

    def _body(self, name: str) -> int:
        bodies = list(self.mechanism.system.bodies)
        if name not in bodies:
            raise SceneError(f"there is no body {name!r}: {one_of(bodies, name)}")
        return bodies.index(name)


def _named(values: dict[str, Array], name: str, kind: str) -> Array:
    if name not in values:
        raise SceneError(f"there is no {kind} {name!r}: {one_of(values, name)}")
    return values[name]
