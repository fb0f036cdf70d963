"""Every force element once, between two bodies that move at random, and what it answers."""

import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import spherejax as sj
from spherejax.motion.equations.body_motions import body_motions
from spherejax.physics.forces.base import power_on_bodies
from spherejax.physics.state import unpack

ENDS = ("first.eye", "second.eye")
UP = (0.0, 0.2, 1.0)


CUBIC = sj.functions.Polynomial([0.0, 1.0, 0.0, 3.0])
TWO_SLOPES = sj.functions.Piecewise([0.0], [sj.functions.Linear(2.0), sj.functions.Linear(5.0)])


def attraction(strength: float) -> sj.forces.AbstractForce:
    """The element in the docstring of `AbstractForce`, as a reader would copy it, on the second body."""
    text = inspect.getdoc(sj.forces.AbstractForce) or ""
    block = text[text.index("    class ") : text.index("Numbers in it")]
    scope: dict[str, Any] = {"sj": sj, "jnp": jnp}
    exec(textwrap.dedent(block).replace("ball", "second"), scope)
    return scope["Attraction"](strength)


def road(x, t):
    """A road that also sinks and rises."""
    return 0.05 * jnp.sin(3.0 * x) + 0.02 * jnp.cos(2.0 * t)


def table(x: float = 1.0) -> sj.functions.SmoothTable:
    """A stiffening spring."""
    return sj.functions.SmoothTable([-0.5, 0.0, 0.1, 0.4, 1.0], x * np.array([-30.0, 0.0, 10.0, 60.0, 200.0]))


CONSERVATIVE: dict[str, sj.forces.AbstractForce] = {
    "spring": sj.SpringDamper(ENDS, 50.0, free_length=0.3),
    "spring along a direction": sj.SpringDamper(ENDS, 50.0, free_length=-0.4, direction=UP),
    "spring by table": sj.SpringDamper(ENDS, 5.0, free_length=0.3, spring=table()),
    "spring on the ground": sj.SpringDamper(
        ("ground", "second"), spring=sj.functions.Polynomial([1.0, 20.0, 0.0, 5.0])
    ),
    "torsion spring": sj.TorsionalSpring(("first", "second"), (1.0, 2.0, 2.0), 8.0, free_angle=0.3),
    "torsion spring by function": sj.TorsionalSpring(
        ("ground", "second"), UP, spring=sj.functions.Polynomial([0.0, 1.0, 0.0, 3.0])
    ),
    "stop, short": sj.forces.BumpStop(ENDS, shortest=0.9, stiffness=1e3),
    "stop, long": sj.forces.BumpStop(ENDS, longest=0.2, stiffness=1e3, onset=0.1),
    "stop, both": sj.forces.BumpStop(ENDS, shortest=0.35, longest=0.5, stiffness=1e3, spring=table(), direction=UP),
    "torsional stop": sj.forces.TorsionalStop(("first", "second"), (1.0, 2.0, 2.0), -0.2, 0.1, 8.0, onset=0.1),
    "torsional stop by table": sj.forces.TorsionalStop(("ground", "second"), UP, largest=-0.3, spring=table()),
    "gear": sj.forces.Gear(
        sj.Turn(("ground", "first"), UP, 0.3), sj.Turn(("first", "second"), (1.0, 2.0, 2.0)), -0.7, 0.1, 40.0
    ),
    "gear with teeth": sj.forces.Gear(
        sj.Turn(("ground", "second"), UP),
        sj.Travel(ENDS, (1.0, 0.3, 0.0)),
        0.4,
        0.02,
        40.0,
        offset=0.1,
        profile=sj.functions.Sine(0.2, 1.0, offset=1.0),
        pitch=0.3,
    ),
    "coupler": sj.forces.Coupler(
        sj.Turn(("ground", "first"), UP, 0.3), sj.Turn(("first", "second"), (1.0, 2.0, 2.0)), -0.7, 40.0, offset=0.1
    ),
    "coupler of a turn and a travel": sj.forces.Coupler(
        sj.Turn(("ground", "second"), UP), sj.Travel(ENDS, (1.0, 0.3, 0.0)), 0.4, 40.0, offset=0.1
    ),
    "tyre": sj.forces.Tyre("second.eye", 0.8, 2e3),
    "tyre, onset and table": sj.forces.Tyre("second.eye", 0.8, 2e3, onset=0.05, spring=table()),
    "tyre, normal": sj.forces.Tyre("second.eye", 0.8, 2e3, road=sj.functions.Sine(0.1, 0.5), normal_to_road=True),
    "user-written": attraction(3.0),
}
DAMPED: dict[str, sj.forces.AbstractForce] = {
    "spring and damper": sj.SpringDamper(ENDS, 50.0, 4.0, 0.3),
    "damper by function": sj.SpringDamper(
        ENDS, damper=sj.functions.Piecewise([0.0], [sj.functions.Linear(2.0), sj.functions.Linear(5.0)]), direction=UP
    ),
    "shock absorber": sj.forces.ShockAbsorber(
        ENDS, sj.functions.Linear(2.0), table(), spring=table(2.0), free_length=0.3
    ),
    "torsion damper": sj.TorsionalSpring(("first", "second"), UP, 8.0, 2.0, damper=jnp.tanh),
    "gear with losses": sj.forces.Gear(
        sj.Travel(("ground", "first.eye"), UP),
        sj.Travel(ENDS, (1.0, 0.3, 0.0)),
        0.4,
        0.1,
        40.0,
        3.0,
        0.05,
        efficiency=0.8,
    ),
    "gear with restitution": sj.forces.Gear(
        sj.Turn(("ground", "first"), UP, 0.3), sj.Turn(("first", "second"), UP), -0.7, 0.1, 40.0, restitution=0.6
    ),
    "coupler with damping": sj.forces.Coupler(
        sj.Travel(("ground", "first.eye"), UP), sj.Travel(ENDS, (1.0, 0.3, 0.0)), 0.4, 40.0, 3.0
    ),
    "stop with damping": sj.forces.BumpStop(ENDS, 0.9, None, 1e3, 30.0, 0.01, damper=lambda v: 5.0 * v),
    "stop with restitution": sj.forces.BumpStop(ENDS, 0.9, None, 1e3, spring=table(), restitution=0.6, transition=0.5),
    "torsional stop with damping": sj.forces.TorsionalStop(
        ("first", "second"), UP, 0.4, None, 8.0, 2.0, 0.1, damper=jnp.tanh
    ),
    "torsional stop with restitution": sj.forces.TorsionalStop(
        ("ground", "second"), UP, -0.1, 0.1, 8.0, onset=0.1, restitution=0.6, transition=0.5
    ),
    "damped tyre": sj.forces.Tyre("second.eye", 0.8, 2e3, 100.0, 0.01, damper=sj.functions.Linear(3.0)),
    "tyre on a moving road": sj.forces.Tyre("second.eye", 0.8, 2e3, 100.0, 0.01, road=road, speed=4.0),
    "tyre, normal to a moving road": sj.forces.Tyre(
        "second.eye", 0.8, 2e3, 50.0, 0.01, road=road, speed=4.0, normal_to_road=True
    ),
}
ACTIVE: dict[str, sj.forces.AbstractForce] = {
    "law of three": sj.SpringDamper(ENDS, law=lambda length, rate, t: 3.0 * length * jnp.sin(t) + rate**3),
    "spring by a user's function": sj.SpringDamper(ENDS, spring=lambda u: 3.0 * u + u**3),
    "push": sj.AppliedWrench("second.eye", (1.0, 2.0, 3.0), (0.1, 0.0, 0.2), place=(0.01, 0.02, 0.0)),
    "push by time": sj.AppliedWrench("second", lambda t: jnp.stack([jnp.sin(t), t, 0.0 * t]), in_body_axes=True),
    "push by state": sj.AppliedWrench("second", moment=lambda t, motions: -t * motions["first"].angular_velocity),
}
ACTIVE["actuator"] = sj.Actuator(sj.Extension(ENDS), sj.functions.Sine(2.0, 1.0), offset=0.5)
ACTIVE["actuator on an axis"] = sj.Actuator(sj.Turn(("first", "second"), UP, 0.3), 1.5)
ELEMENTS = {**CONSERVATIVE, **DAMPED, **ACTIVE}
TWO_BODIED = [name for name, force in ELEMENTS.items() if set(force.body_names) == {"first", "second"}]


def scene_with(force: sj.forces.AbstractForce) -> sj.Scene:
    """Two free bodies and one element."""
    first = sj.Body(2.0, [0.2, 0.3, 0.4], quaternion=_unit([0.9, 0.1, -0.2, 0.3]), points={"eye": (0.1, 0.0, 0.05)})
    second = sj.Body(
        1.0,
        [0.1, 0.1, 0.15],
        position=(0.2, 0.1, 0.6),
        quaternion=_unit([0.8, -0.3, 0.1, 0.2]),
        points={"eye": (0, -0.1, 0.02)},
    )
    return sj.Scene({"first": first, "second": second}, forces={"element": force})


def answer(force: sj.forces.AbstractForce) -> Callable[..., Any]:
    """(t, y) -> wrenches, energy, results and power of the element, as array code."""
    system = sj.equations.compile_scene(scene_with(force)).system
    placed = system.forces["element"]

    def of_state(t, y):
        motions = body_motions(system, unpack(system.layout, y))
        wrenches = placed.wrenches(t, motions)
        return {
            "wrenches": {name: wrench for name, wrench in wrenches.items() if name != "ground"},
            "energy": placed.potential_energy(t, motions),
            "parts": placed.parts(t, motions),
            "power": power_on_bodies(wrenches, motions),
        }

    return of_state


def program(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of (t, y) as a scalar program that is evaluated at once, without compiling."""
    return sj.compiler.scalarize(function, jnp.zeros(()), jnp.zeros(26)).compute


def states(n: int = 6) -> list[np.ndarray]:
    """Random states of the two bodies near each other, moving."""
    random = np.random.default_rng(7)
    rows = []
    for _ in range(n):
        bodies = [
            np.concatenate([place + 0.3 * random.normal(size=3), _unit(random.normal(size=4))])
            for place in (np.zeros(3), np.array([0.2, 0.1, 0.6]))
        ]
        rows.append(np.concatenate([*bodies, random.normal(size=12)]))
    return rows


def advanced(y: np.ndarray, h: float) -> np.ndarray:
    """Positions moved on along the velocities for a time."""
    moved = y.copy()
    for i in range(2):
        place, speed = slice(7 * i, 7 * i + 3), 14 + 6 * i
        turn = h * y[speed + 3 : speed + 6]
        moved[place] += h * y[speed : speed + 3]
        moved[7 * i + 3 : 7 * i + 7] = _product(_from_vector(turn), y[7 * i + 3 : 7 * i + 7])
    return moved


def _from_vector(turn):
    angle = np.linalg.norm(turn)
    return np.concatenate([[np.cos(angle / 2)], np.sinc(angle / 2 / np.pi) / 2 * turn])


def _product(p, q):
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def _unit(x):
    return np.asarray(x) / np.linalg.norm(x)
