"""What the rig answers: curves with units, a table, a figure."""

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.types import Number
from spherejax.studies.rig.bench import LOADS, Corner
from spherejax.studies.rig.characteristics import GIVES
from spherejax.studies.rig.dataset import dataset_of, table_of, write_csv
from spherejax.studies.rig.shown import SHOWN, RigStatus

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class Vehicle(NamedTuple):
    """What of the car anti-dive and Ackermann ask for.

    Attributes:
        wheelbase: [m].
        center_of_mass_height: over the road [m].
        brake_share: share of the braking force on this axle [-].
        drive_share: share of the driving force on this axle [-].
        is_rear: whether the corner is of the rear axle.
    """

    wheelbase: Number
    center_of_mass_height: Number
    brake_share: Number = 0.6
    drive_share: Number = 1.0
    is_rear: bool = False


class Rig(eqx.Module):
    """Curves of a corner on the rig; prints a table. All arrays have one entry a position, in SI units.

    Signs are those of ISO 8855: x forward, y to the left, z up, whichever side the corner is on.

    Attributes:
        travel: how far the contact patch is lifted over its design position [m], positive in bump.
        steer: displacement of the steering [m], or its angle [rad].
        loads: longitudinal and lateral force at the contact patch [N], aligning moment [N m], longitudinal force at
            the wheel's center [N]; shape (n, 4).
        toe: positive toe-in [rad].
        camber: positive with the wheel's top outwards [rad].
        caster: positive with the steering axis' top to the rear [rad]; this and the next three None without an axis.
        kingpin_inclination: positive with its top inwards [rad].
        scrub_radius: offset of the axis on the road, positive inward of the contact patch [m].
        caster_trail: positive with the axis ahead of the contact patch [m].
        track_change: of the half track, at the contact patch, from where it was drawn, positive outwards [m].
        recession: how far the wheel's center has gone to the rear [m].
        center_travel: how far the wheel's center has gone up [m].
        wheel_load: vertical force of the platform [N].
        wheel_rate: its derivative by travel [N/m].
        motion_ratio: compression of the spring by travel [-]; None without a spring.
        roll_center_height: kinematic, over the road, of an axle with this corner on both sides [m].
        braking_angle: of the path of the contact patch in side view, brakes on the carrier [rad]; positive where
            the patch goes forward in bump.
        driving_angle: the same of the wheel's center, for a wheel that a shaft drives [rad].
        toe_gradient: derivative of toe by travel [rad/m].
        camber_gradient: derivative of camber by travel [rad/m].
        steer_gradient: derivative of the wheel's angle to the left by `steer` [rad/m or 1]; None without steering.
        steering_effort: force [N] or moment [N m] with which the steering is held; None without.
        compliance: derivatives of toe, camber [rad], and of the place in x and y of the tread's point on the road [m],
            the wheel being locked to its carrier, by each load (shape (n, 4, 4), in the order of `loads`), at fixed
            travel and steer; zeros where all joints are ideal.
        status: `RigStatus` of each position; where it is not FOUND, the curves are NaN.
        side: 1 for a left corner, -1 for a right one.
        corner: names.
    """

    travel: Float[Array, " n"]
    steer: Float[Array, " n"]
    loads: Float[Array, "n 4"]
    toe: Float[Array, " n"]
    camber: Float[Array, " n"]
    caster: Any
    kingpin_inclination: Any
    scrub_radius: Any
    caster_trail: Any
    track_change: Float[Array, " n"]
    recession: Float[Array, " n"]
    center_travel: Float[Array, " n"]
    wheel_load: Float[Array, " n"]
    wheel_rate: Float[Array, " n"]
    motion_ratio: Any
    roll_center_height: Float[Array, " n"]
    braking_angle: Float[Array, " n"]
    driving_angle: Float[Array, " n"]
    toe_gradient: Float[Array, " n"]
    camber_gradient: Float[Array, " n"]
    steer_gradient: Any
    steering_effort: Any
    compliance: Float[Array, "n 4 4"]
    status: Int[Array, " n"]
    side: Any
    corner: Corner = eqx.field(static=True)

    @property
    def curves(self) -> dict[str, Float[Array, " n"]]:
        """The characteristics that there are, by name."""
        return {name: getattr(self, name) for name in SHOWN if getattr(self, name) is not None}

    @property
    def is_found(self) -> Any:
        """Which positions have a result, shape (n,)."""
        return self.status == RigStatus.FOUND

    def compliance_of(self, gives: str, load: str) -> Float[Array, " n"]:
        """One compliance coefficient, e.g. `rig.compliance_of("toe", "lateral")` [rad/N].

        Args:
            gives: "toe", "camber" [rad]; "longitudinal", "lateral": the tread's point on the road in x and y [m].
            load: "longitudinal", "lateral", "driving" [N], "aligning" [N m].

        Raises:
            SceneError: for another name.
        """
        for name, names in ((gives, GIVES), (load, LOADS)):
            if name not in names:
                raise SceneError(f"there is no compliance {name!r}; {one_of(names, name)}")
        return self.compliance[..., GIVES.index(gives), LOADS.index(load)]

    def anti_dive(self, vehicle: Vehicle) -> Float[Array, " n"]:
        """Share of the dive (front) or lift (rear) under braking that the suspension's linkage takes [-].

            share tan(braking angle) wheelbase / height of the center of mass    (with the sign turned at the rear)

        Source: Milliken and Milliken (1995), Race Car Vehicle Dynamics, section 17.3.
        """
        return _anti(self.braking_angle, vehicle.brake_share, vehicle)

    def anti_lift(self, vehicle: Vehicle) -> Float[Array, " n"]:
        """Share of the lift (front) or squat (rear) under driving forces that it takes [-]; see `anti_dive`."""
        return _anti(self.driving_angle, vehicle.drive_share, vehicle)

    def wheel_angle(self) -> Float[Array, " n"]:
        """The wheel's steer angle to the left [rad]: toe with the sign of the side."""
        return -self.side * self.toe

    def ackermann(self, vehicle: Vehicle, track: Number) -> Float[Array, " n"]:
        """How near the axle steers to Ackermann's geometry [-]: 1 where both wheels roll about one center.

            (inner - outer) / (inner of Ackermann - outer),    cot(outer) - cot(inner of Ackermann) = track/wheelbase

        The other wheel is this one's mirror image with the steering on the other side: the rig must have been asked
        for steer and for -steer.

        Args:
            vehicle: with the wheelbase.
            track: between the contact patches [m].

        Limits: NaN, as a quotient of zeros, where the steering is straight.

        Raises:
            SceneError: where a steer has no opposite among the positions, at the same travel.
        """
        return _ackermann(self, vehicle, track)

    def to_xarray(self) -> "xarray.Dataset":
        """Curves and compliance in SI units, with units and labels, over travel, or steer, or positions."""
        return dataset_of(self)

    def to_csv(self, path: Any) -> None:
        """Write the table in degrees, millimeters, newtons per millimeter; units in the head."""
        write_csv(self, path)

    def figure(self) -> "Figure":
        """The curves."""
        from spherejax.output.plot.rig import rig

        return rig({"": self.to_xarray()})

    def __str__(self) -> str:
        return table_of(self)

    def __repr__(self) -> str:
        is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(self))
        return "Rig(traced)" if is_traced or np.ndim(self.travel) != 1 else str(self)


def _anti(angle: Any, share: Number, vehicle: Vehicle) -> Any:
    sign = -1.0 if vehicle.is_rear else 1.0
    xp: Any = np if isinstance(angle, np.ndarray) else jnp
    return sign * share * xp.tan(angle) * vehicle.wheelbase / vehicle.center_of_mass_height


def _ackermann(rig: Rig, vehicle: Vehicle, track: Number) -> Any:
    steer, travel = np.asarray(rig.steer), np.asarray(rig.travel)
    places = np.column_stack([steer, travel])
    apart = np.abs(places[:, None] * [-1.0, 1.0] - places[None]).max(-1)
    mirror, missing = apart.argmin(1), apart.min(1) > 1e-12  # equal numbers, but for rounding
    if np.any(missing):
        raise SceneError(
            f"ackermann: there is no position with steer = {-steer[missing][0]:.6g} at the same travel; ask "
            f"sj.vehicle.rig for "
            "steer from -a to a, e.g. np.linspace(-0.05, 0.05, 11)"
        )
    angle = rig.wheel_angle()
    other = -angle[mirror]
    # The inner wheel of a turn is the one on the side that both turn to.
    turns_inward = angle * rig.side > 0
    inner, outer = (np.where(turns_inward, *pair) for pair in ((angle, other), (other, angle)))
    inner, outer = np.abs(inner), np.abs(outer)
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.arctan(1.0 / (1.0 / np.tan(outer) - track / vehicle.wheelbase))
        return np.where(steer == 0, np.nan, (inner - outer) / (wanted - outer))
