"""Adversarial scenes, chosen to provoke wrong numbers without a warning: families of cases with independent answers.

A family is a structure and a way to draw its numbers; its answer is a closed form (or a statement that there is none,
so that the run must not succeed). A case is judged by one rule: a run that says SUCCEEDED, with no check of its audit
out of range, no warning and no error, must be right.

    right   succeeded, and within the family's tolerance of the answer
    told    an error, a status other than SUCCEEDED, a warning, or a check out of range
    SILENT  succeeded, said nothing, and wrong: what must not happen

Cases of a family are one batch under `jit(vmap)` where their functions may close over what is drawn, and single calls,
as a user makes them, where the fault would be a function's own.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj
from spherejax.motion.integration.audit import N_FATAL

Numbers = dict[str, float]

MAX_STEPS = 200_000
"""Largest number of steps: the batch does not wait long for one lane, and a run that needs more fails with a status."""


@dataclass(frozen=True)
class Family:
    """A structure, its numbers, and what is right.

    Attributes:
        draw: numbers of a case by a generator.
        scene: the scene of these numbers.
        times: sample times of these numbers.
        observe: what is compared, from the run and the numbers.
        right: the answer; None where a run must not succeed.
        scale: how large an error may be.
        alone: whether each case is a call of its own.
        options: of `simulate`.
        least_right: share of the cases that must be right, not merely told.
    """

    draw: Callable[[np.random.Generator], Numbers]
    scene: Callable[..., sj.Scene]
    observe: Callable[..., Any]
    right: Callable[..., Any]
    scale: Callable[..., float]
    times: Callable[..., Any] = lambda **_: jnp.array([0.0, 1.0])
    alone: bool = False
    options: Any = ()
    least_right: float = 0.9
    differentiated_by: str | None = None

    def answer(self, numbers):
        """The observed value (or its derivative by `differentiated_by`), the status, and the audit."""

        def compared(value):
            arguments = numbers if self.differentiated_by is None else {**numbers, self.differentiated_by: value}
            options = {"max_steps": MAX_STEPS, **dict(self.options)}
            run = sj.simulate(self.scene(**arguments), self.times(**arguments), **options)
            return jnp.asarray(self.observe(run, **arguments)), (run.ended, run.stats.audit)

        if self.differentiated_by is None:
            return compared(None)
        return jax.jacfwd(compared, has_aux=True)(jnp.asarray(numbers[self.differentiated_by], jnp.float64))


@dataclass(frozen=True)
class Verdict:
    """How a case ended: "right", "told" or "SILENT", and in words."""

    kind: str
    words: str


def verdicts(family: Family, seeds) -> list[Verdict]:
    """Each case of a family, judged."""
    cases = [family.draw(np.random.default_rng(seed)) for seed in seeds]
    if family.alone:
        return [_judged(family, numbers, *_alone(family, numbers)) for numbers in cases]
    batch = {name: jnp.array([numbers[name] for numbers in cases]) for name in cases[0]}
    values, (ended, audits) = jax.jit(jax.vmap(family.answer))(batch)
    rows = zip(np.asarray(values), np.asarray(ended), np.asarray(audits), strict=True)
    return [_judged(family, numbers, *row, said="") for numbers, row in zip(cases, rows, strict=True)]


def _alone(family: Family, numbers: Numbers):
    """Value, status, audit and words of a single call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value, (ended, audit) = family.answer(numbers)
        except (sj.SceneError, sj.SimulationError) as error:
            return np.nan, -1, np.zeros(N_FATAL), str(error)
    said = "; ".join(str(one.message) for one in caught if one.category.__module__.startswith("spherejax"))
    return np.asarray(value), int(ended), np.asarray(audit), said


def _judged(family: Family, numbers: Numbers, value, ended, audit, said: str) -> Verdict:
    cautions = np.asarray(audit)[N_FATAL:]
    right = family.right(**numbers)
    about = ", ".join(f"{name} = {number:.17g}" for name, number in numbers.items())
    succeeded = right is not None and int(ended) == sj.Status.SUCCEEDED
    # `<=` is false for NaN.
    if succeeded and np.all(np.abs(np.asarray(value) - np.asarray(right)) <= family.scale(**numbers)):
        return Verdict("right", about)
    if said or int(ended) != sj.Status.SUCCEEDED or np.any(cautions > 1):
        return Verdict("told", f"{about}: {said or f'status {int(ended)}'}")
    return Verdict("SILENT", f"{about}: {np.asarray(value).tolist()} where {right} is right")


# Parts that many scenes share ------------------------------------------------------------------------------------


def _wheel(inertia, rate, **more):
    return sj.Body(1.0, (inertia, inertia, inertia), angular_velocity=(0.0, 0.0, rate), **more)


def _axle(body, model=None):
    return sj.Revolute(("ground", body), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), model)


def _at_rest(mass=1.0):
    return sj.Body(mass, (1.0, 1.0, 1.0))


WEIGHTLESS = (0.0, 0.0, 0.0)
AXIS = (0.0, 0.0, 1.0)


def _logarithmic(random, low, high):
    return float(10 ** random.uniform(math.log10(low), math.log10(high)))


# Many turns ------------------------------------------------------------------------------------------------------


def _oscillation(random):
    """Amplitudes from a tenth of a radian to ten turns, and any phase of three periods."""
    frequency = float(random.uniform(2.0, 18.0))
    sign = float(random.choice([-1.0, 1.0]))
    return {
        "inertia": _logarithmic(random, 1e-4, 1e2),
        "frequency": frequency,
        "rate": sign * frequency * _logarithmic(random, 0.1, 60.0),
    }


def _spun_spring(inertia, frequency, rate):
    spring = sj.TorsionalSpring(("ground", "wheel"), AXIS, inertia * frequency**2)
    return sj.Scene({"wheel": _wheel(inertia, rate)}, {"axle": _axle("wheel")}, {"spring": spring}, gravity=WEIGHTLESS)


def _bushing(inertia, frequency):
    translation, rotation = 1e3 * np.eye(3), inertia * frequency**2 * jnp.eye(3)
    law = sj.laws.MatrixElastomer(translation, np.zeros((3, 3)), rotation, np.zeros((3, 3)))
    return sj.Bushing(law=law)


def _spun_hinge_bushing(inertia, frequency, rate):
    model = _bushing(inertia, frequency)
    return sj.Scene({"wheel": _wheel(inertia, rate)}, {"axle": _axle("wheel", model)}, gravity=WEIGHTLESS)


def _spun_ball_bushing(inertia, frequency, rate):
    body = _wheel(inertia, rate, points={"center": (0.0, 0.0, 0.0)})
    joint = sj.Spherical("ground.socket", "wheel.center", _bushing(inertia, frequency))
    return sj.Scene({"wheel": body}, {"ball": joint}, gravity=WEIGHTLESS, ground_points={"socket": (0.0, 0.0, 0.0)})


def _rate_of(run, **_):
    return run.angular_velocity("wheel")[-1, 2]


def _rate_after(inertia, frequency, rate):
    return rate * math.cos(frequency)


def _gears(random):
    return {
        "ratio": float(random.choice([-1.0, 1.0])) * _logarithmic(random, 0.2, 5.0),
        "torque": float(random.choice([-1.0, 1.0])) * _logarithmic(random, 0.1, 100.0),
        "load": _logarithmic(random, 0.1, 10.0),
    }


MESH = 1e5
"""Stiffness of a mesh [N m/rad]; the wheels' own oscillation against each other is below 1e-3 of a turn."""


def _gear_pair(ratio, torque, load):
    one, two = sj.Turn(("ground", "pinion"), AXIS), sj.Turn(("ground", "wheel"), AXIS)
    forces = {
        "mesh": sj.forces.Coupler(one, two, ratio=ratio, stiffness=MESH),
        "motor": sj.AppliedWrench("pinion", moment=jnp.stack([0.0 * torque, 0.0 * torque, torque])),
    }
    bodies = {"pinion": _wheel(1.0, 0.0), "wheel": _wheel(load, 0.0)}
    return sj.Scene(bodies, {"one": _axle("pinion"), "two": _axle("wheel")}, forces, gravity=WEIGHTLESS)


def _geared_rate(ratio, torque, load):
    """Of the wheel after a second, as of a rigid pair: the mesh oscillates about it by `_mesh_rate`."""
    return ratio * torque / (1 + ratio**2 * load)


def _mesh_rate(ratio, torque, load):
    """Largest rate of the mesh's oscillation, in the wheel's rate.

    u = x_2 - ratio x_1 with u'' = -k (1/J_2 + ratio^2/J_1) u - ratio torque/J_1, and x_2' = (rigid pair) + u' share.
    """
    frequency = math.sqrt(MESH * (1 / load + ratio**2))
    return abs(ratio * torque) / frequency / (1 + ratio**2 * load)


# Singular mechanisms ---------------------------------------------------------------------------------------------


def _loop(random):
    return {"base": _logarithmic(random, 0.3, 3.0), "speed": _logarithmic(random, 0.5, 30.0)}


def _hinge(first, second, point):
    return sj.Revolute((first, second), point, AXIS)


def _rod(position, velocity, rate):
    return sj.Body(1.0, (0.1, 0.1, 0.1), position, velocity=velocity, angular_velocity=(0.0, 0.0, rate))


def _parallelogram(base, speed, drift=None):
    zero = 0.0 * base
    bodies = {
        "left": _rod((0.0, 0.5, 0.0), (speed / 2, 0.0, 0.0), -speed),
        "right": _rod(jnp.stack([base, 0.5 + zero, zero]), (speed / 2, 0.0, 0.0), -speed),
        "bar": _rod(jnp.stack([base / 2, 1.0 + zero, zero]), (speed, 0.0, 0.0), 0.0),
    }
    at = partial(jnp.stack, axis=0)
    joints = {
        "a": _hinge("ground", "left", (0.0, 0.0, 0.0)),
        "b": _hinge("ground", "right", at([base, zero, zero])),
        "c": _hinge("left", "bar", (0.0, 1.0, 0.0)),
        "d": _hinge("bar", "right", at([base, 1.0 + zero, zero])),
    }
    more = {} if drift is None else {"drift": drift}
    return sj.Scene(bodies, joints, gravity=(0.0, -9.81, 0.0), **more)


def _even_slider_crank(base, speed, drift=None):
    """Crank and rod of one length: where the slider is at the crank's axis, two motions meet."""
    length, zero = base, 0.0 * base
    half, quarter = length * math.sqrt(0.5), length * math.sqrt(0.125)
    rate = speed / length
    at = partial(jnp.stack, axis=0)
    crank = sj.Body(
        1.0,
        (0.1, 0.1, 0.1),
        at([quarter, quarter, zero]),
        velocity=at([-rate * quarter, rate * quarter, zero]),
        angular_velocity=at([zero, zero, rate]),
    )
    rod = sj.Body(
        1.0,
        (0.1, 0.1, 0.1),
        at([3 * quarter, quarter, zero]),
        velocity=at([-3 * rate * quarter, rate * quarter, zero]),
        angular_velocity=at([zero, zero, -rate]),
    )
    slider = sj.Body(1.0, (0.1, 0.1, 0.1), at([2 * half, zero, zero]), velocity=at([-2 * rate * half, zero, zero]))
    joints = {
        "axle": _hinge("ground", "crank", (0.0, 0.0, 0.0)),
        "pin": _hinge("crank", "rod", at([half, half, zero])),
        "wrist": _hinge("rod", "slider", at([2 * half, zero, zero])),
        "guide": sj.Prismatic(("ground", "slider"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    }
    more = {} if drift is None else {"drift": drift}
    return sj.Scene({"crank": crank, "rod": rod, "slider": slider}, joints, gravity=WEIGHTLESS, **more)


def _kept_energy(run, **_):
    energy = run.mechanical_energy
    # Of what moves: beside the speed at the start, three bodies of 1 kg that fall by up to 2 m.
    return (energy[-1] - energy[0]) / (run.kinetic_energy[0] + 40.0)


# Prescribed motions ----------------------------------------------------------------------------------------------


def _driven_rod(angle):
    rod = sj.Body(1.0, (1.0, 1.0, 1.0), (1.0, 0.0, 0.0))
    driver = sj.RotationDriver(("ground", "rod"), AXIS, angle)
    return sj.Scene({"rod": rod}, {"axle": _axle("rod"), "motor": driver}, gravity=WEIGHTLESS)


def _angle_of_rod(run, **_):
    x, y = run.position("rod")[-1, :2].T
    return jnp.arctan2(y, x)


def _jump(random):
    return {"at": float(random.uniform(0.1, 0.9)), "size": _logarithmic(random, 1e-5, 1.0)}


def _kink(random):
    return {"at": float(random.uniform(0.1, 0.9)), "rate": _logarithmic(random, 1e-3, 2.0)}


# Functions of time -----------------------------------------------------------------------------------------------


def _pushed(force):
    zero = jnp.zeros(())
    push = sj.AppliedWrench("ball", force=lambda t: jnp.stack([jnp.asarray(force(t)), zero, zero]))
    return sj.Scene({"ball": _at_rest()}, {}, {"push": push}, gravity=WEIGHTLESS)


def _speed_of(run, **_):
    return run.velocity("ball")[-1, 0]


def _pulse(random):
    """Down to 1/20,000 of the motion, the documented bound: a function is looked at between the stages that often."""
    width = _logarithmic(random, 5e-5, 1e-1)
    return {"width": width, "at": float(random.uniform(0.05, 0.85))}


NOT_FINITE: dict[str, tuple[Callable, Callable | None]] = {
    # name: force by time and a number, and the speed after a second; None where there is none.
    "1/t": (lambda t, c: c / t, None),
    "root": (lambda t, c: c * jnp.sqrt(t), lambda c: c * 2 / 3),
    "root of what becomes negative": (lambda t, c: jnp.sqrt(0.3 * c - t), None),
    "pole": (lambda t, c: c / (t - 0.5), None),
    "NaN from an instant on": (lambda t, c: jnp.where(t > 0.1 + 0.1 * c, jnp.nan, 1.0), None),
    "infinite for an instant": (lambda t, c: jnp.where(jnp.abs(t - 0.5) < 1e-3 * c, jnp.inf, 1.0), None),
    "overflow": (lambda t, c: jnp.exp(3000.0 * c * t), None),
    "norm": (lambda t, c: jnp.linalg.norm(jnp.stack([t, c * t])), lambda c: math.sqrt(1 + c * c) / 2),
}

NOT_SMOOTH_DRIVERS: dict[str, tuple[Callable, Callable | None]] = {
    # name: angle by time and a number, and that after a second; None where no motion has it.
    "root": (lambda t, c: c * jnp.sqrt(t), None),
    "norm": (lambda t, c: jnp.linalg.norm(jnp.stack([t, c * t])), lambda c: math.sqrt(1 + c * c)),
    "power": (lambda t, c: c * t**1.5, lambda c: c),
    "logarithm": (lambda t, c: c * jnp.log(t + 1e-320), None),
    "arc": (lambda t, c: jnp.arcsin(t * (1.0 + 0.1 * c)), None),
}


def _by_name(table, name, kind):
    function, right = table[name]
    return Family(
        draw=lambda random: {"c": _logarithmic(random, 0.3, 2.0)},
        scene=lambda c: kind(lambda t: function(t, c)),
        observe=_speed_of if kind is _pushed else _angle_of_rod,
        right=lambda c: None if right is None else right(c),
        scale=lambda c: 1e-5 * c,
        alone=True,
        options=(("max_steps", 20_000),),
        least_right=0.0,
    )


# Stops -----------------------------------------------------------------------------------------------------------


def _bounce(random):
    return {"stiffness": _logarithmic(random, 1e3, 1e10), "gap": float(random.uniform(0.1, 0.6))}


def _ball_and_stop(stiffness, gap, start=0.0):
    ball = sj.Body(1.0, (1.0, 1.0, 1.0), jnp.stack([start * jnp.ones(()), jnp.zeros(()), jnp.zeros(())]),
                   velocity=(1.0, 0.0, 0.0))  # fmt: skip
    stop = sj.forces.BumpStop(("ball", "ground.o"), shortest=0.2, stiffness=stiffness)
    place = jnp.stack([gap + 0.2, 0.0 * gap, 0.0 * gap])
    return sj.Scene({"ball": ball}, {}, {"stop": stop}, gravity=WEIGHTLESS, ground_points={"o": place})


def _bounced(stiffness, gap, start=0.0):
    """Half a period of the spring in contact, then back at the same speed."""
    return gap - (1.0 - (gap - start) - math.pi / math.sqrt(stiffness))


# Closures and times ----------------------------------------------------------------------------------------------


def _closed_over(random):
    return {"a": _logarithmic(random, 0.1, 10.0), "b": _logarithmic(random, 0.5, 20.0)}


def _damped_ball(a, b):
    damper = sj.SpringDamper(("ground", "ball"), damper=lambda rate: a * jnp.tanh(b * rate), direction=(1.0, 0.0, 0.0))
    ball = sj.Body(1.0, (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), velocity=(0.5, 0.0, 0.0))
    return sj.Scene({"ball": ball}, {}, {"damper": damper}, gravity=WEIGHTLESS)


def _damped_speed(a, b):
    """v' = -a tanh(b v): sinh(b v) = sinh(b v_0) exp(-a b t)."""
    return math.asinh(math.sinh(0.5 * b) * math.exp(-a * b)) / b


def _later(random):
    return {"tau": float(random.uniform(0.2, 1.0)), "speed": _logarithmic(random, 0.5, 20.0)}


def _thrown(tau, speed):
    ball = sj.Body(1.0, (1.0, 1.0, 1.0), velocity=(0.0, 0.0, speed))
    return sj.Scene({"ball": ball}, {}, gravity=(0.0, 0.0, -9.81))


# Films -----------------------------------------------------------------------------------------------------------


def _loaded(random):
    return {"clearance": _logarithmic(random, 3e-6, 5e-5), "eps": float(random.uniform(0.2, 0.7))}


def _ocvirk(clearance, eps):
    size = 0.01 * 100 * math.pi * 5e-3 * 5e-3**3 / (4 * clearance**2)
    return size * eps / (1 - eps**2) ** 2 * (16 * eps**2 + math.pi**2 * (1 - eps**2)) ** 0.5


def _loaded_journal(clearance, eps):
    normal = sj.Hertz(stiffness=1e9)
    model = sj.Lubricated(clearance, 0.01, socket_radius=5e-3, normal=normal, film=sj.laws.ShortBearing(5e-3))
    rotor = sj.Body(1e-3, (10.0, 10.0, 10.0), angular_velocity=(0.0, 0.0, 100 * math.pi))
    load = _ocvirk(clearance, eps)
    push = sj.AppliedWrench("rotor", force=jnp.stack([0.0 * load, -load, 0.0 * load]))
    return sj.Scene({"rotor": rotor}, {"bearing": _axle("rotor", model)}, {"load": push}, gravity=WEIGHTLESS)


FAMILIES: dict[str, Family] = {
    "wheel on a torsion spring": Family(
        _oscillation, _spun_spring, _rate_of, _rate_after, lambda rate, **_: 1e-5 * abs(rate)
    ),
    "wheel in a hinge's matrix bushing": Family(
        _oscillation, _spun_hinge_bushing, _rate_of, _rate_after, lambda rate, **_: 1e-5 * abs(rate), least_right=0.0
    ),
    "ball in a matrix bushing": Family(
        _oscillation, _spun_ball_bushing, _rate_of, _rate_after, lambda rate, **_: 1e-5 * abs(rate), least_right=0.0
    ),
    "gears": Family(_gears, _gear_pair, _rate_of, _geared_rate, lambda **n: 1.01 * _mesh_rate(**n)),
    "parallelogram": Family(
        _loop, _parallelogram, _kept_energy, lambda **_: 0.0, lambda **_: 1e-3, lambda **_: jnp.array([0.0, 1.0, 4.0])
    ),
    "parallelogram with Baumgarte's control": Family(
        _loop, partial(_parallelogram, drift=sj.solvers.Baumgarte()), _kept_energy, lambda **_: 0.0, lambda **_: 1e-2,
        lambda **_: jnp.array([0.0, 1.0, 4.0]), least_right=0.0,
    ),
    "slider-crank of equal lengths": Family(
        _loop, _even_slider_crank, _kept_energy, lambda **_: 0.0, lambda **_: 1e-3,
        lambda **_: jnp.array([0.0, 1.0, 4.0]), least_right=0.0,
    ),
    "prescribed jump, a function": Family(
        _jump, lambda at, size: _driven_rod(lambda t: jnp.where(t < at, 0.0, size)), _angle_of_rod,
        lambda at, size: size, lambda size, **_: 1e-5 * size, alone=True, least_right=0.0,
    ),
    "prescribed jump, a Step": Family(
        _jump, lambda at, size: _driven_rod(sj.functions.Step(at, 0.0, size)), _angle_of_rod,
        lambda at, size: size, lambda size, **_: 1e-5 * size, alone=True, least_right=0.0,
    ),
    "prescribed kink": Family(
        _kink, lambda at, rate: _driven_rod(lambda t: rate * jnp.maximum(t - at, 0.0)), _angle_of_rod,
        lambda at, rate: rate * (1 - at), lambda rate, **_: 1e-4 * rate, alone=True, least_right=0.0,
    ),
    "pulse": Family(
        _pulse, lambda width, at: _pushed(lambda t: jnp.where((t > at) & (t < at + width), 1 / width, 0.0)), _speed_of,
        lambda **_: 1.0, lambda **_: 1e-3, least_right=0.0,
    ),
    "linear stop": Family(_bounce, _ball_and_stop, lambda run, **_: run.position("ball")[-1, 0], _bounced,
                          lambda **_: 1e-7),
    "derivative through a linear stop": Family(
        lambda random: {**_bounce(random), "start": 0.0}, _ball_and_stop,
        lambda run, **_: run.position("ball")[-1, 0], lambda **_: -1.0, lambda **_: 1e-6, differentiated_by="start",
    ),
    "closure": Family(_closed_over, _damped_ball, _speed_of, _damped_speed, lambda **_: 1e-6),
    "derivative by what a function closes over": Family(
        _closed_over, _damped_ball, _speed_of,
        lambda a, b: -math.tanh(b * _damped_speed(a, b)), lambda **_: 1e-6, differentiated_by="a",
    ),
    "derivative by a sample time": Family(
        _later, _thrown, lambda run, **_: run.position("ball")[-1, 2],
        lambda tau, speed: speed - 9.81 * tau, lambda **_: 1e-7,
        lambda tau, **_: jnp.stack([0.0 * tau, tau]), differentiated_by="tau",
    ),
    "loaded journal": Family(
        _loaded, _loaded_journal, lambda run, **_: run.eccentricity_ratio("bearing")[-1],
        lambda clearance, eps: eps, lambda clearance, eps: 0.025 * eps,
        lambda **_: jnp.array([0.0, 0.1]), options=(("rtol", 1e-6),),
    ),
    **{f"force: {name}": _by_name(NOT_FINITE, name, _pushed) for name in NOT_FINITE},
    **{f"driver: {name}": _by_name(NOT_SMOOTH_DRIVERS, name, _driven_rod) for name in NOT_SMOOTH_DRIVERS},
}  # fmt: skip
"""By name. Numbers of a case follow from its seed alone."""
