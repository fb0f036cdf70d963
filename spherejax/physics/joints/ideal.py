"""The ideal model: constraint equations (Eqs 3 to 10) instead of forces, and friction by their reaction."""

from typing import Annotated, ClassVar

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative, numeric, positive
from spherejax.foundations.types import Number, Unit
from spherejax.physics.joints.base import AbstractSphericalModel, Effect
from spherejax.physics.laws.friction import AbstractFrictionLaw
from spherejax.physics.laws.pressure import AbstractPressure, CosinePressure

FEWEST_PASSES, MOST_PASSES = 2, 20
"""Passes of the fixed point: with fewer nothing tells how it contracts, and what needs more is no fixed point."""


class Ideal(AbstractSphericalModel):
    """The joint's equations hold exactly: no clearance; no dissipation, unless `friction` is given.

    Of a spherical joint the centers coincide. Friction follows the joint's reaction F, which depends on the friction in
    turn: it is found in `passes` of a fixed point, whose contraction every run reports (`run.part(joint,
    "friction_contraction")`) and audits. A preload stands beside the reaction, as a ball joint of a car has it, whose
    socket presses on the ball without any load:

        M = -mu(v) R |F| (k_perp (I - n n^T) + k_par n n^T) w/|w| - M_0 mu(v)/mu_k w/|w|,    v = R |w|

    of a ball that turns with w in its socket; the module `reaction_friction` has it for shafts, sliders and crosses.

    Attributes:
        friction: law of the friction, or None. A law with bristles (`LuGre`) makes the joint stick.
        radius: R, of the ball, or of the shaft in its bearing [m]; a slider needs none.
        pressure: how the reaction is spread over the surfaces: `CosinePressure()` where it is left out,
            `UniformPressure()`, `PointContact()`, `PreloadAlone()`.
        preload: M_0, moment of friction without load, of joints that turn [N m].
        preload_force: friction force without load, of joints that slide along their axis [N].
        length: of the bearing, which then carries moments across its axis at its two ends [m]; left out, they press
            nothing.
        passes: of the fixed point in which friction and reactions are made to agree (static).
    """

    is_ideal: ClassVar[bool] = True

    friction: AbstractFrictionLaw | None = None
    radius: Annotated[Number | None, Unit("m")] = None
    pressure: AbstractPressure | None = None
    preload: Annotated[Number | None, Unit("N m")] = None
    preload_force: Annotated[Number | None, Unit("N")] = None
    length: Annotated[Number | None, Unit("m")] = None
    passes: int = eqx.field(static=True, default=4)

    @property
    def distribution(self) -> AbstractPressure:
        """How the reaction is spread."""
        return CosinePressure() if self.pressure is None else self.pressure

    @property
    def follows_reaction(self) -> bool:
        """Whether there is friction that depends on the reaction (static)."""
        return self.friction is not None and self.distribution.follows_reaction

    @property
    def never_adds_energy(self) -> bool:
        """Where its friction law does not."""
        return self.friction is None or self.friction.never_adds_energy

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Friction."""
        if self.friction is None:
            return ()
        bristles = ", with bristles" if self.friction.bristle_size else ""
        how = f"{self.passes} passes" if self.follows_reaction else "preload alone"
        return (Effect(f"friction in the ideal joint ({type(self.friction).__name__}{bristles}; {how})", self),)

    def requirements(self) -> list[Requirement]:
        """A legal friction law, and numbers that belong to it; a kind of joint may ask for more."""
        if self.friction is None:
            return self._meaningless_without_friction()
        law, name = self.friction, type(self.friction).__name__
        found = [
            required if required.value is law else required._replace(field=f"{name}.{required.field}")
            for required in law.requirements()
        ]
        lengths = {"radius": self.radius, "length": self.length}
        found += [positive(field, value, "m") for field, value in lengths.items() if value is not None]
        for field, value, unit in (("preload", self.preload, "N m"), ("preload_force", self.preload_force, "N")):
            if value is not None:
                found += [non_negative(field, value, unit), self._measured_by_law(field, law.sliding_coefficient)]
        is_count = isinstance(self.passes, int) and FEWEST_PASSES <= self.passes <= MOST_PASSES
        what = f"be a whole number from {FEWEST_PASSES} to {MOST_PASSES}"
        found.append(Requirement("passes", self.passes, is_count, what, "Leave it out for 4."))
        if not self.distribution.follows_reaction and self.preload is None and self.preload_force is None:
            remedy = "Give preload= [N m] (or preload_force= [N] where the joint slides), or another pressure."
            found.append(Requirement("pressure", type(self.pressure).__name__, False, "come with a preload", remedy))
        return found

    def _meaningless_without_friction(self) -> list[Requirement]:
        given = {
            name: value
            for name in ("radius", "pressure", "preload", "preload_force", "length")
            if (value := getattr(self, name)) is not None
        }
        remedy = "Give a law, e.g. friction=Threlfall(mu=0.1), or leave this out."
        return [Requirement(name, value, False, "come with friction=", remedy) for name, value in given.items()]

    def _measured_by_law(self, field: str, coefficient: Number | None) -> Requirement:
        """A preload is scaled by the law's coefficient of fast sliding, which must be known and not vanish."""
        what = "come with a friction law whose coefficient of fast sliding is positive"
        remedy = "Give mu (or mu_kinetic) above zero; a law of your own names it in `sliding_coefficient`."
        is_known = False if coefficient is None else numeric(coefficient) > 0
        return Requirement(field, getattr(self, field), is_known, what, remedy)
