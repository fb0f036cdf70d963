"""A hip prosthesis in its cup over gait cycles."""

import math

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.types import Number, Scalar, Vector3
from spherejax.model.drift import AbstractDriftControl, PostStabilization
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body
from spherejax.physics.forces.base import AbstractForce, Wrench
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.joints.spherical import Spherical
from spherejax.physics.laws.material import Material
from spherejax.physics.laws.normal import HuntCrossley

CUP_RADIUS, CLEARANCE = 14.05e-3, 50e-6
"""Metal on metal, nominal diameter 28 mm: inner radius of the cup and radial clearance [m]."""

SYNOVIAL_VISCOSITY = 2.5e-3
"""Periprosthetic synovial fluid at high shear rates [Pa s]."""

COBALT_CHROMIUM = (210e9, 0.3)
"""Young's modulus [Pa] and Poisson's ratio of the alloy of cup and head."""


class Gait(AbstractForce):
    """Load on the head and moment of the muscles over a gait cycle.

        F_z = swing + (peak - swing) shape(t / period),    shape = (sin(pi s / 0.6) + 0.35 sin(3 pi s / 0.6))_+ / 0.88

    while the foot is on the ground (s < 0.6 of the cycle), a curve with two humps, and F_z = swing after. The moment
    about y swings the leg sinusoidally with the amplitude `flexion`.

    Attributes:
        body: name of the loaded body.
        peak: largest load [N].
        swing: load in the swing phase [N].
        period: of the cycle [s].
        flexion: amplitude of the leg's swing [rad].
        moment_of_inertia: of the leg about the hip [kg m^2].
    """

    body: str = eqx.field(static=True)
    peak: Number
    swing: Number
    period: Number
    flexion: Number
    moment_of_inertia: Number

    @property
    def body_names(self):
        """The one body."""
        return (self.body,)

    def load(self, t: Scalar) -> Scalar:
        """F_z [N]."""
        part = t / self.period
        phase = (part - jnp.floor(part)) * (jnp.pi / STANCE)
        humps = (jnp.sin(phase) + SECOND_HUMP * jnp.sin(3 * phase)) / LARGEST
        return self.swing + (self.peak - self.swing) * jnp.where(phase < jnp.pi, jnp.maximum(humps, 0.0), 0.0)

    def wrenches(self, t, motions):
        """Along z at the center of the head, and about y."""
        del motions
        frequency = 2 * jnp.pi / self.period
        moment = -self.moment_of_inertia * self.flexion * frequency**2 * jnp.sin(frequency * t)
        return {self.body: Wrench(_along(2, self.load(t)), _along(1, moment))}


STANCE, SECOND_HUMP = 0.6, 0.35
"""Share of the cycle in which the foot is on the ground; strength of the third harmonic, which makes two humps."""

LARGEST = 2 / 3 * (1 + 3 * SECOND_HUMP) * math.sqrt((1 + 3 * SECOND_HUMP) / (12 * SECOND_HUMP))
"""Largest value of sin(x) + h sin(3 x): at sin(x)^2 = (1 + 3 h) / (12 h)."""


def hip(
    model: AbstractSphericalModel | None = None,
    *,
    peak: Number = 3000.0,
    swing: Number = 300.0,
    period: Number = 1.0,
    flexion: Number = math.pi / 9,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """The head of a hip prosthesis in a lubricated metal cup, under the loads and the flexion of walking.

    The body `"femur"` carries the head at its center; the studied joint is `"cup"`, with the socket in the pelvis,
    which is the ground. The load presses the head upwards, along z; the leg swings about y. Six degrees of freedom with
    a film or contact. What is hard: film and contact act within microseconds, while a step takes a second. A
    squeezed film alone cannot carry the stance: the head sinks through it within milliseconds and rests on the metal.

    Args:
        model: model of the joint; by default a synovial film between metal surfaces, with contact beyond it.

    Other args:
        peak: largest load [N]; four times the body weight of 75 kg, as in the standard for simulators.
        swing: load in the swing phase [N].
        period: of a gait cycle [s].
        flexion: amplitude of flexion and extension [rad]; 20 degrees by default.
        drift: drift control; `PostStabilization()` by default.

    Magnitudes: ISO 14242-1 (3 kN peak, 300 N in swing, 1 Hz; flexion from -18 to 25 degrees, here a sine of 20); Jin
    and Dowson (1999), Proc. Inst. Mech. Eng. C 213:355-370, for film lubrication of hard heads of 28 mm (clearances of
    tens of micrometers, 2.5 mPa s, 210 GPa). The leg swings as a body of 3 kg and 0.1 kg m^2 about the hip; the film
    is the library's, squeeze and wedge, of a rigid and unpierced sphere: a loaded hip deforms.
    """
    inertia = 0.1
    frequency = 2 * math.pi / period
    femur = Body(
        3.0,
        (inertia, inertia, inertia),
        angular_velocity=(0.0, flexion * frequency, 0.0),
        points={"head": (0.0, 0.0, 0.0)},
    )
    return Scene(
        {"femur": femur},
        {"cup": Spherical("ground.cup", "femur.head", synovial_joint() if model is None else model)},
        {"gait": Gait("femur", peak, swing, period, flexion, inertia)},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"cup": (0.0, 0.0, 0.0)},
        drift=PostStabilization() if drift is None else drift,
    )


def synovial_joint() -> Lubricated:
    """Metal on metal with a film of synovial fluid; the film gives way to contact between 0.1 and 0.2 micrometers."""
    metal = Material(*COBALT_CHROMIUM)
    return Lubricated(
        CLEARANCE,
        viscosity=SYNOVIAL_VISCOSITY,
        socket_radius=CUP_RADIUS,
        normal=HuntCrossley(restitution=0.9),
        socket_material=metal,
        ball_material=metal,
        e_h0=1e-7,
        e_h1=2e-7,
    )


def _along(axis: int, value: Scalar) -> Vector3:
    zero = jnp.zeros(())
    return jnp.stack([value if i == axis else zero for i in range(3)])
