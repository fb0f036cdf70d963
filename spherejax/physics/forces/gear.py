"""Gears, racks and screws with backlash: two coordinates whose teeth meet on both flanks.

Counted in the second coordinate, the teeth are apart by

    u = x_2 - ratio x_1 - offset

and free while |u| < j/2, with the backlash j. Beyond, the flank presses by the law of
`spherejax.physics.forces.one_sided`, with the depth p = |u| - j/2 and its rate,

    f = max(0, K ramp(p) + rise(p) c p_rate),    or with a restitution e    f = K ramp(p) (1 + h s(p_rate))
    K = stiffness profile(x_1/pitch)

and x_2 feels -sign(u) f, x_1 feels sign(u) ratio f. The factor `profile` of the stiffness goes on with the number of
teeth that have passed. What is stored is E = K A(p), with A the integral of the ramp, and where the stiffness varies,
x_1 feels -dE/dx_1 at constant u besides: without this part, which others leave out, an idle pair would gain or lose
energy with each tooth.

Losses in the mesh follow the force that it transmits: with the efficiency eta, x_1 feels in addition

    -(1/eta - 1) |ratio f| s(x_1_rate)

with s the smooth sign. A pair that is driven by x_1 then needs f ratio/eta there, and delivers f: the efficiency is
eta. Driven by x_2 it gives 2 - 1/eta of the work back, and locks itself for eta <= 1/2, as screws do.

Source: backlash as a dead zone with one stiffness and damping for both flanks as in Kahraman and Singh (1990), J. Sound
Vib. 142:49-75, there with a stiffness that varies by time; losses by the force as of an inclined plane.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement, is_concrete
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.types import Function, Number, Scalar, Unit
from spherejax.physics.forces.base import UNITS
from spherejax.physics.forces.coupler import (
    AbstractCoordinate,
    CoordinateMotion,
    coupled_requirements,
    coupled_wrenches,
)
from spherejax.physics.forces.one_sided import TRANSITION, AbstractStop, OneSided, Stops, smooth_sign
from spherejax.physics.functions.base import AbstractFunction, as_function, function_requirements
from spherejax.physics.functions.shapes import finite


class Mesh(NamedTuple):
    """What a pair of flanks does.

    Attributes:
        lag: u [m or rad].
        lag_rate: its time derivative.
        force: on x_2, -sign(u) f [N or N m].
        on_first: on x_1, with losses [N or N m].
        energy: E [J].
        lost: power that damping, restitution and losses take [W].
    """

    lag: Scalar
    lag_rate: Scalar
    force: Scalar
    on_first: Scalar
    energy: Scalar
    lost: Scalar


class Gear(AbstractStop):
    """A pair of toothed wheels, a rack and its pinion, or a screw and its nut, with backlash and an elastic mesh.

        u = x_2 - ratio x_1 - offset,    free for |u| < backlash/2,    f = K ramp(p) + rise(p) c p_rate beyond

        sj.forces.Gear(
            sj.Turn(("housing", "pinion"), axis=(0, 0, 1), radius=0.02),
            sj.Turn(("housing", "wheel"), axis=(0, 0, 1), radius=0.06),
            ratio=-1.0, backlash=1e-4, stiffness=1e8,
        )
        # a screw of 5 mm a turn
        sj.forces.Gear(sj.Turn(both, axis), sj.Travel(ends, axis), ratio=0.005 / (2 * jnp.pi), ...)

    Numbers are in the units of the second coordinate: m and N, or rad and N m of a `Turn` without a radius. Angles go
    on through any number of turns. A step of the integration ends where a flank is met or left. Several pairs one
    behind the other are a gear train.

    Attributes:
        first: the coordinate x_1, a `Turn`, a `Travel` or an `Extension`.
        second: the coordinate x_2.
        ratio: of x_2 to x_1 [-, rad/m or m/rad]; -1 of wheels that mesh outside, measured on their pitch radii.
        backlash: j, how far x_2 may go from flank to flank while x_1 stands [m or rad].
        stiffness: of the mesh, on either flank [N/m or N m/rad].
        damping: c [N s/m or N m s/rad]; it needs an onset.
        onset: depth over which stiffness and damping build up [m or rad]; with 0, the default, the stiffness is there
            at once and the force has a kink.
        offset: u = 0, the middle of the gap, where x_2 is this much more than ratio x_1 [m or rad]; at the start of the
            motion both coordinates are 0.
        restitution: e, speed after a meeting of flanks by that before [-], in (0, 1]; instead of damping. None: nothing
            is lost but by damping.
        transition: rate of u within which the restitution is smooth [m/s or rad/s].
        profile: factor on the stiffness [-] by the number of teeth that have passed, x_1/pitch: positive, of period 1
            for teeth that are alike, `sj.functions.Sine(0.2, 1.0, offset=1.0)`; None: 1.
        pitch: of the teeth, in the first coordinate [rad or m]; needed with a profile.
        efficiency: eta of a pair that x_1 drives, in (0, 1].
        loss_rate: rate of x_1 within which the losses are smooth [rad/s or m/s].

    Limits: no force presses the wheels apart, and the loss counts between the first coordinate's own two bodies. At a
    depth of zero the force is zero, with a kink without an onset. In a reversal within +-loss_rate the losses are less.
    Without backlash use a `Coupler`. What flanks that rest on each other do in a reversal slower than `transition` is
    that of a damper.
    """

    first: AbstractCoordinate
    second: AbstractCoordinate
    ratio: Number
    backlash: Number
    stiffness: Number
    damping: Number
    onset: Number
    offset: Number
    restitution: Number | None
    transition: Number
    profile: AbstractFunction | None
    pitch: Number | None
    efficiency: Number
    loss_rate: Number

    def __init__(
        self,
        first: AbstractCoordinate,
        second: AbstractCoordinate,
        ratio: Annotated[Number, Unit("{ratio}", "-, rad/m or m/rad")] = 1.0,
        backlash: Annotated[Number, Unit("{second}", "m or rad")] = 0.0,
        stiffness: Annotated[Number, Unit("{stiffness}", "N/m or N m/rad")] = 0.0,
        damping: Annotated[Number, Unit("{damping}", "N s/m or N m s/rad")] = 0.0,
        onset: Annotated[Number, Unit("{second}", "m or rad")] = 0.0,
        offset: Annotated[Number, Unit("{second}", "m or rad")] = 0.0,
        *,
        restitution: Annotated[Number | None, Unit("1")] = None,
        transition: Annotated[Number, Unit("{second}/s", "m/s or rad/s")] = TRANSITION,
        profile: Annotated[Callable | None, Function("1", "1")] = None,
        pitch: Annotated[Number | None, Unit("{first}", "rad or m")] = None,
        efficiency: Annotated[Number, Unit("1")] = 1.0,
        loss_rate: Annotated[Number, Unit("{first}/s", "rad/s or m/s")] = TRANSITION,
    ):
        self.first = first
        self.second = second
        self.ratio = ratio
        self.backlash = backlash
        self.stiffness = stiffness
        self.damping = damping
        self.onset = onset
        self.offset = offset
        self.restitution = restitution
        self.transition = transition
        self.profile = as_function(profile)
        self.pitch = pitch
        self.efficiency = efficiency
        self.loss_rate = loss_rate

    @staticmethod
    def unit_words(first: AbstractCoordinate, second: AbstractCoordinate) -> dict[str, str]:
        """Units of its numbers by its coordinates."""
        one, other = first.part_units["position"], second.part_units["position"]
        stiffness, damping = ("N m/rad", "N m s/rad") if second.is_angle else ("N/m", "N s/m")
        ratio = "1" if one == other else f"{other}/{one}"
        return {"first": one, "second": other, "ratio": ratio, "stiffness": stiffness, "damping": damping}

    @property
    def part_units(self) -> Mapping[str, str]:
        """Of the second coordinate, and of the first for what it feels."""
        units = self.second.part_units
        of_second = {"lag": units["position"], "lag_rate": units["rate"], "depth": units["position"]}
        return {**UNITS, **of_second, "force": units["effort"], "effort_on_first": self.first.part_units["effort"]}

    @property
    def spring(self) -> AbstractFunction | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """None: the law is a stiffness."""
        return None

    @property
    def damper(self) -> AbstractFunction | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """None: the law is a damping."""
        return None

    @property
    def limits(self) -> tuple[Scalar | Number, Scalar | Number]:
        """-backlash/2 and backlash/2."""
        return -self.backlash / 2, self.backlash / 2

    @property
    def n_touches(self) -> int:
        """Two flanks."""
        return 2

    @property
    def force_at_touch(self) -> Scalar | None:
        """None: the force grows from zero."""
        return None

    @property
    def never_adds_energy(self) -> bool:
        """It stores and dissipates, with a stiffness that varies as well."""
        return True

    @property
    def conserves_energy(self) -> bool:
        """Without damping, restitution below 1 and losses."""
        is_lossless = is_concrete(self.efficiency) and bool(np.all(np.asarray(self.efficiency) == 1))
        # Said without the limits, which are computed from the backlash: the system may have shapes for numbers.
        return is_lossless and self._law(self.stiffness).conserves_energy

    def coordinate_and_rate(self, motions) -> tuple[Scalar, Scalar]:
        """u [m or rad] and its rate."""
        return self._lag(self.first.motion(motions), self.second.motion(motions))

    def _lag(self, first: CoordinateMotion, second: CoordinateMotion) -> tuple[Scalar, Scalar]:
        return second.value - self.ratio * first.value - self.offset, second.rate - self.ratio * first.rate

    def _mesh(self, motions) -> Mesh:
        first, second = self.first.motion(motions), self.second.motion(motions)
        u, rate = self._lag(first, second)
        factor, slope = self._factor(first.value)
        pull = Stops(self._law(self.stiffness * factor), *self.limits).pull(u, rate)
        driving = self.ratio * pull.force
        # E is in proportion to the factor.
        turning = -pull.energy * slope / factor
        loss = (1.0 / self.efficiency - 1.0) * jnp.abs(driving)
        resisting = loss * smooth_sign(first.rate, jnp.asarray(self.loss_rate))
        lost = (pull.force - pull.elastic) * rate + resisting * first.rate
        return Mesh(u, rate, -pull.force, driving + turning - resisting, pull.energy, lost)

    def _law(self, stiffness: Scalar | Number) -> OneSided:
        return OneSided(stiffness, self.damping, None, None, self.onset, self.restitution, self.transition)

    def _factor(self, position: Scalar) -> tuple[Scalar, Scalar]:
        """The factor on the stiffness and its derivative by x_1."""
        if self.profile is None or self.pitch is None:
            return jnp.ones(()), jnp.zeros(())
        pitch, profile = self.pitch, self.profile
        return jax.jvp(lambda x: jnp.asarray(profile(x / pitch)), (position,), (jnp.ones(()),))

    def wrenches(self, t, motions):
        """Of both coordinates, added up where they share a body."""
        del t
        mesh = self._mesh(motions)
        return coupled_wrenches(self.first, self.second, motions, mesh.on_first, mesh.force)

    def potential_energy(self, t, motions):
        """E [J]."""
        del t
        return self._mesh(motions).energy

    def parts(self, t, motions) -> dict[str, Array]:
        """`lag` u [m or rad], `lag_rate`, `depth` of the flanks, 0 apart, `force` on x_2 [N or N m], that on x_1
        (`effort_on_first`), `dissipated_power` by damping, restitution and losses [W].
        """
        del t
        mesh = self._mesh(motions)
        depth = jnp.maximum(jnp.abs(mesh.lag) - self.backlash / 2, 0.0)
        return {
            "lag": mesh.lag,
            "lag_rate": mesh.lag_rate,
            "depth": depth,
            "force": mesh.force,
            "effort_on_first": mesh.on_first,
            "dissipated_power": mesh.lost,
        }

    def placed(self, bodies, find):
        """Both coordinates in body axes."""
        placed = self.first.placed(bodies, find), self.second.placed(bodies, find)
        return eqx.tree_at(lambda force: (force.first, force.second), self, placed)

    def requirements(self) -> list[Requirement]:
        """Two coordinates, a positive backlash and stiffness, the law's own, a pitch with a profile, 0 < eta <= 1."""
        units = self.unit_words(self.first, self.second)
        effort = "N m" if self.second.is_angle else "N"
        eta = numeric(self.efficiency)
        remedy = "1 is a mesh without losses, 0.98 a good one; a screw has 0.3."
        needs = "Give the pitch of the teeth in the first coordinate, 2 pi / 21 rad for 21 teeth, with a profile."
        together = (self.profile is None) == (self.pitch is None)
        gap = "Without backlash use a Coupler."
        return [
            *coupled_requirements(self.first, self.second),
            finite("ratio", self.ratio),
            positive("backlash", self.backlash, units["second"])._replace(remedy=gap),
            positive("stiffness", self.stiffness, units["stiffness"]),
            *self._law(self.stiffness).requirements(effort, units["second"]),
            finite("offset", self.offset),
            *function_requirements("profile", self.profile),
            Requirement("pitch", self.pitch, together, "stand with a profile, and only there", needs),
            *([] if self.pitch is None else [positive("pitch", self.pitch, units["first"])]),
            Requirement("efficiency", self.efficiency, (eta > 0) & (eta <= 1), "lie in (0, 1]", remedy),
            positive("loss_rate", self.loss_rate, f"{units['first']}/s"),
        ]

    @property
    def body_names(self) -> tuple[str, ...]:
        """The bodies of both coordinates, each once."""
        return tuple(dict.fromkeys((*self.first.body_names, *self.second.body_names)))
