"""The bushing: ball and socket joined by an elastomer, without clearance (sections 3.4 and 4.4)."""

from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.rotation import normalized, rotation_vector
from spherejax.foundations.types import Number, Numeric, Quadruple, Scalar, Unit, Vector3
from spherejax.physics.bodies import numbers, unit_norm
from spherejax.physics.joints.base import AbstractSphericalModel, Effect, Medium, Response
from spherejax.physics.laws.elastomer import AbstractElastomer, RadialElastomer
from spherejax.physics.laws.viscoelastic import Berg, Maxwell, free_directions
from spherejax.physics.memory import MemoryEntry, Scale, vector
from spherejax.physics.orientations import as_quaternion


class Bushing(AbstractSphericalModel):
    """Ball and socket joined by an elastomer.

    `Bushing(stiffness=k, damping=b)` is the paper's Eq. 41, f = k (delta + b delta_dot) n, with b in seconds. Other
    laws are given whole: `Bushing(law=VectorElastomer(...))`, `MatrixElastomer`, `CurveElastomer`, or a user's own.
    To any of them `branches` add relaxation and `friction` what makes rubber stiffer for small amplitudes.

    Attributes:
        law: how the elastomer resists.
        branches: relaxation, or None.
        friction: friction inside the rubber, or None.
        relaxed_quaternion: orientation of the ball's body against the socket's in which the elastomer has no moment: a
            unit quaternion, scalar first, axes of the ball's body to those of the socket's, shape (4,); or a rotation
            matrix (3, 3), or a `Rotation` of SciPy. A motion that starts with another orientation starts twisted. None:
            as the bodies are described, by their `reference_quaternion` or else their `quaternion`.

    Args:
        stiffness: k of the paper's law, instead of `law` [N/m].
        damping: b of the paper's law, stiffness-proportional [s].

    The force acts on both bodies at the ball's center; rotations are counted from the relaxed orientation. What
    branches and friction remember are deflections in the socket's axes, three for each branch and three for friction,
    as many again for rotations; they start at zero.
    """

    law: AbstractElastomer
    branches: Maxwell | None = None
    friction: Berg | None = None
    relaxed_quaternion: Quadruple | None = None

    @property
    def never_adds_energy(self) -> bool:
        """Where its law does not; branches and friction never do."""
        return self.law.never_adds_energy

    def __init__(
        self,
        stiffness: Annotated[Number | None, Unit("N/m")] = None,
        damping: Annotated[Number | None, Unit("s")] = None,
        *,
        law: AbstractElastomer | None = None,
        branches: Maxwell | None = None,
        friction: Berg | None = None,
        relaxed_quaternion: Annotated[Quadruple, Unit("1")] = None,
    ):
        if (law is None) == (stiffness is None):
            raise TypeError("give either stiffness= (and damping=) or law=, not both and not neither")
        if law is not None and damping is not None:
            raise TypeError("damping= belongs to stiffness=; a law= brings its own")
        if law is None:
            assert stiffness is not None
            law = RadialElastomer(stiffness, 0.0 if damping is None else damping)
        self.law = law
        self.branches = branches
        self.friction = friction
        self.relaxed_quaternion = None if relaxed_quaternion is None else numbers(as_quaternion(relaxed_quaternion))

    def relaxed(self, start: Numeric) -> Numeric:
        """Its own relaxed orientation where it has one."""
        if self.relaxed_quaternion is None:
            return start
        own = normalized(jnp.asarray(self.relaxed_quaternion))
        # Of its two signs that of the shorter way from the start: rotations go on from there through half a turn.
        return jnp.where(own @ jnp.asarray(start) < 0, -own, own)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The elastomer, then its relaxation, then its friction."""
        kind = "translation and rotation" if self.law.resists_rotation else "translation"
        own = self.relaxed_quaternion
        what = f"elastomer, {kind} ({type(self.law).__name__})"
        found = [Effect(what, Bushing(law=self.law, relaxed_quaternion=own))]
        if self.branches is not None:
            n = self.branches.n_branches
            what = f"relaxation, {n} branch{'es' if n > 1 else ''} (Maxwell)"
            found.append(Effect(what, Bushing(law=self.law, branches=self.branches, relaxed_quaternion=own)))
        if self.friction is not None:
            found.append(Effect("friction in the rubber (Berg)", self))
        return tuple(found)

    def requirements(self) -> list[Requirement]:
        """What elastomer, branches and friction require; these must not resist what the elastomer leaves free."""
        required = [*self.law.requirements(), *self._relaxed_requirements()]
        for name, part, rotational in (
            ("branches", self.branches, "rotational_stiffness"),
            ("friction", self.friction, "rotational_limit"),
        ):
            if part is None:
                continue
            required += [r._replace(field=f"{name}.{r.field}") for r in part.requirements()]
            given = getattr(part, rotational)
            if given is not None and not self.law.resists_rotation:
                remedy = (
                    f"{type(self.law).__name__} leaves rotation free: leave out {rotational}, or take MatrixElastomer."
                )
                field = f"{name}.{rotational}"
                required.append(Requirement(field, given, False, "be None for a law without moments", remedy))
        if self.branches is not None:
            required += self._sliding_requirements("branches.stiffness", self.branches.stiffness, 1)
        if self.friction is not None:
            required += self._sliding_requirements("friction.limit", self.friction.limit, 0)
        return required

    def _relaxed_requirements(self) -> list[Requirement]:
        """A unit quaternion, where there is an elastomer that it means something to."""
        given = self.relaxed_quaternion
        if given is None:
            return []
        if not self.law.resists_rotation:
            remedy = f"{type(self.law).__name__} leaves rotation free: leave it out, or take MatrixElastomer."
            return [Requirement("relaxed_quaternion", given, False, "be None for a law without moments", remedy)]
        return [unit_norm("relaxed_quaternion", given)]

    def _sliding_requirements(self, field: str, value, n_axes: int) -> list[Requirement]:
        """Nothing along an axis on which a law by matrices leaves the joint to slide.

        Args:
            field: name of the numbers.
            value: of them.
            n_axes: how many axes the array has where its numbers are alike in all directions.
        """
        law: Any = self.law
        if not hasattr(law, "stiffness") or np.shape(law.stiffness) != (3, 3):
            return []
        given = numeric(value)
        along = given if given.ndim > n_axes else given[..., None]
        if along.shape[-1] not in (1, 3):
            return []  # the part itself says so
        free = free_directions(law.stiffness, law.damping)
        remedy = "The law lets the joint slide along that axis; give three numbers along the axes, with a zero there."
        return [Requirement(field, value, ~free | (along == 0), "be zero where the law has no stiffness", remedy)]

    # What is remembered -----------------------------------------------------------------------------------------------

    @property
    def _remembered(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each vector that is remembered, in the order of the memory (static)."""
        found = []
        if self.branches is not None:
            numbered = range(1, self.branches.n_branches + 1)
            found += [(f"branch_{k}", "m") for k in numbered]
            if self.branches.rotational_stiffness is not None:
                found += [(f"branch_{k}_turn", "rad") for k in numbered]
        if self.friction is not None:
            found.append(("friction", "m"))
            if self.friction.rotational_limit is not None:
                found.append(("friction_turn", "rad"))
        return tuple(found)

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """Deflections of the branches, then of friction: none without them."""
        scales: dict[str, Scale] = {"m": "length", "rad": "angle"}
        return tuple(entry for name, unit in self._remembered for entry in vector(name, unit, scales[unit]))

    @property
    def medium(self) -> Medium:
        """An elastomer."""
        return Medium.ELASTOMER

    def rotation_share(self, motion) -> Scalar | None:
        """As its law has it."""
        return self.law.rotation_share(motion.relative_quaternion)

    def respond(self, motion, memory) -> Response:
        """Elastic and damping force and moment on the ball, then those of branches and friction."""
        e, socket = motion.eccentricity, motion.socket_rotation
        rate_on_socket = motion.eccentricity_rate - jnp.cross(motion.socket_angular_velocity, e)
        deflection, deflection_rate = e, rate_on_socket
        if not self.law.isotropic:
            deflection, deflection_rate = socket.T @ e, socket.T @ rate_on_socket
        force = self.law.force(deflection, deflection_rate)
        if not self.law.isotropic:
            force = socket @ force
        rotation, measure, moment = jnp.zeros(3), jnp.zeros(3), jnp.zeros(3)
        relative = socket.T @ (motion.ball_angular_velocity - motion.socket_angular_velocity)
        if self.law.resists_rotation:
            rotation = rotation_vector(motion.relative_quaternion)
            measure = self.law.measure_of_rotation(motion.relative_quaternion)
            moment = socket @ self.law.moment(measure, relative)
        energy = self.law.elastic_energy(deflection, measure)
        parts = {"deflection": deflection, "rotation": rotation}
        rates = jnp.zeros(0)
        if self._remembered:
            more = self._remembering(memory, socket.T @ rate_on_socket, measure, relative)
            parts |= {name: socket @ part for name, part in more.parts.items()}
            force = force + socket @ more.force
            moment = moment + socket @ more.moment
            energy, rates = energy + more.energy, more.rates
        return Response(
            force=force,
            ball_moment=moment,
            socket_moment=-jnp.cross(e, force) - moment,
            memory_rate=rates,
            elastic_energy=energy,
            parts=parts,
        )

    def _remembering(self, memory, rate: Vector3, measure: Vector3, relative: Vector3) -> "_Remembering":
        """What branches and friction do.

        Args:
            memory: the joint's memory.
            rate: of the deflection, as seen from the socket, in its axes [m/s].
            measure: of the rotation, as the law has it.
            relative: angular velocity of the ball against the socket, socket axes [rad/s].
        """
        kept = {name: memory[3 * i : 3 * i + 3] for i, (name, _) in enumerate(self._remembered)}
        turns = any(unit == "rad" for _, unit in self._remembered)
        resisted = self.law.resisted_rotation(measure) if turns else jnp.zeros((3, 3))
        turn_rate = resisted @ relative
        zero = jnp.zeros(3)
        force, moment, energy = zero, zero, jnp.zeros(())
        rates: list = []
        parts = {}
        if self.branches is not None:
            numbered = range(1, self.branches.n_branches + 1)
            branches = jnp.stack([kept[f"branch_{k}"] for k in numbered])
            rates.append(self.branches.rates(branches, rate).ravel())
            parts["branch_force"] = self.branches.force(branches)
            force, energy = force + parts["branch_force"], energy + self.branches.elastic_energy(branches)
            if self.branches.rotational_stiffness is not None:
                branches = jnp.stack([kept[f"branch_{k}_turn"] for k in numbered])
                rates.append(self.branches.rates(branches, turn_rate).ravel())
                parts["branch_moment"] = resisted.T @ self.branches.moment(branches)
                moment, energy = moment + parts["branch_moment"], energy + self.branches.rotational_energy(branches)
        if self.friction is not None:
            bristle = kept["friction"]
            rates.append(self.friction.rate(bristle, rate))
            parts["friction_force"] = self.friction.force(bristle)
            force, energy = force + parts["friction_force"], energy + self.friction.elastic_energy(bristle)
            if self.friction.rotational_limit is not None:
                bristle = kept["friction_turn"]
                rates.append(self.friction.rotational_rate(bristle, turn_rate))
                parts["friction_moment"] = resisted.T @ self.friction.moment(bristle)
                moment, energy = moment + parts["friction_moment"], energy + self.friction.rotational_energy(bristle)
        return _Remembering(force, moment, energy, jnp.concatenate(rates), parts)


class _Remembering(NamedTuple):
    """What branches and friction do, in socket axes.

    Attributes:
        force: on the ball [N].
        moment: on the ball [N m].
        energy: that they store [J].
        rates: of the memory [m/s, rad/s].
        parts: forces and moments by name.
    """

    force: Vector3
    moment: Vector3
    energy: Scalar
    rates: Array
    parts: dict[str, Array]
