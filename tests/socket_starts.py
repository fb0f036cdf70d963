"""Random starts of a ball in a dry socket, and what their runs must obey: energy, the wall, the exact reference."""

from dataclasses import dataclass
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from event_exact import Ball, Contact, Path, ball_path, hertzian_stiffness, hysteresis_factor

import spherejax as sj

LAWS = ("Hertz", "HuntCrossley", "LankaraniNikravesh", "Gonthier", "Flores", "ExactRestitution")
SPEEDS, CLEARANCES = (5e-3, 5.0), (1e-6, 5e-3)
N_COMPARED, N_LATER = 32, 33
"""Samples in the first `2 MAX_ONSETS` crossings, where the reference is followed, and later."""

MAX_ONSETS, MAX_STEPS = 8, 1000
"""Impacts, and steps in one contact, that the reference follows; some starts would bounce or vibrate for ever."""

CROSSINGS = (8.0, 300.0)
"""How long runs last, in times to cross the clearance at the speed of the start: missed contacts were seen after ten to
a hundred of them, where impacts have become slow and steps long."""

DISTURBANCE = 30.0
"""The reference is repeated with its start and its clearance wrong by this many relative tolerances. Runs that miss
nothing deviate by 0.01 of that, and up to 0.3 where
Hertz's force, which remembers nothing, begins and ends within steps."""

ALLOWED = 3.0
"""A run may deviate by this many of the deviations that the disturbances cause."""

SMALLEST_DISTURBANCE = 3e-9
"""Onsets are landed on to within a landing window of 1e-8 of the crossing function, at any tolerance; the reference
itself is good to some 1e-11."""


@dataclass(frozen=True)
class Laws:
    """What is compiled: the laws of a joint. Everything else about a start is a number."""

    normal: str
    friction: bool

    def __str__(self) -> str:
        return self.normal + (" with friction" if self.friction else "")

    def scene(self, numbers) -> sj.Scene:
        """The ball in its socket; `numbers` may be traced."""
        law = getattr(sj.laws, self.normal)
        normal = law() if self.normal == "Hertz" else law(restitution=numbers["restitution"])
        friction = sj.Threlfall(mu=numbers["mu"], v1=numbers["v1"]) if self.friction else None
        ball = sj.Body(
            numbers["mass"],
            numbers["inertia"] * jnp.ones(3),
            position=numbers["position"],
            velocity=numbers["velocity"],
            angular_velocity=numbers["spin"],
            points={"center": (0.0, 0.0, 0.0)},
        )
        model = sj.Dry(numbers["clearance"], normal=normal, friction=friction)
        return sj.Scene(
            {"ball": ball},
            {"joint": sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)},
            gravity=numbers["gravity"],
            ground_points={"socket": (0.0, 0.0, 0.0)},
        )

    def contact(self, numbers) -> Contact:
        """The same joint for the reference."""
        clearance = float(numbers["clearance"])
        return Contact(
            clearance,
            hysteresis_factor(self.normal, float(numbers["restitution"])),
            hertzian_stiffness(0.010, clearance),
            mu=float(numbers["mu"]) if self.friction else 0.0,
            v1=float(numbers["v1"]),
        )


ALL_LAWS = tuple(Laws(normal, friction) for normal in LAWS for friction in (False, True))


def ball(numbers) -> Ball:
    """The ball for the reference."""
    return Ball(*(numbers[key] for key in ("mass", "inertia", "position", "velocity", "spin", "gravity")))


def log_uniform(random, low, high):
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def direction(random):
    x = random.normal(size=3)
    return x / np.linalg.norm(x)


def draw(random: np.random.Generator, n: int):
    """Starts that take about equally long to cross their clearances, and sample times over some crossings.

    A random speed and clearance fix the time to cross; the others of the group have other clearances and speeds of the
    same ratio, as far as they stay in the ranges.
    """
    speed, clearance = log_uniform(random, *SPEEDS), log_uniform(random, *CLEARANCES)
    low = max(CLEARANCES[0], SPEEDS[0] * clearance / speed)
    high = min(CLEARANCES[1], SPEEDS[1] * clearance / speed)
    clearances = [clearance, *(log_uniform(random, low, high) for _ in range(n - 1))]
    starts = [start(random, c, c * speed / clearance) for c in clearances]
    crossing = np.median([s["clearance"] / _typical_speed(s) for s in starts])
    first = np.linspace(0.0, 2 * MAX_ONSETS * crossing, N_COMPARED, endpoint=False)
    later = np.linspace(2 * MAX_ONSETS, 2 * MAX_ONSETS + log_uniform(random, *CROSSINGS), N_LATER)
    return starts, np.concatenate([first, later * crossing])


def _typical_speed(numbers):
    fallen = np.sqrt(2 * np.linalg.norm(numbers["gravity"]) * numbers["clearance"])
    return max(np.linalg.norm(numbers["velocity"]), fallen)


def start(random, clearance: float, speed: float) -> dict[str, np.ndarray]:
    """One start: mass and inertia, place within the clearance (half of them in the center), velocity (a quarter of
    them vertical, in the plane of gravity to rounding), spin."""
    mass = log_uniform(random, 0.02, 2.0)
    place = random.choice([0.0, random.uniform(0, 0.95)]) * clearance * direction(random)
    numbers = {
        "mass": mass,
        "inertia": mass * 0.01**2 * log_uniform(random, 0.1, 1.0),
        "clearance": clearance,
        "restitution": random.uniform(0.2, 0.99),
        "mu": random.uniform(0.0, 0.3),
        "v1": max(1e-3, speed * log_uniform(random, 0.02, 0.5)),
        "position": place,
        "velocity": speed * (direction(random) if random.uniform() < 0.75 else np.array([0.0, 0.0, 1.0])),
        "spin": random.choice([0.0, 1.0]) * speed / 0.01 * random.normal(size=3),
        "gravity": np.array([0.0, 0.0, random.choice([0.0, 9.81, 9.81, 9.81])]) * -1.0,
    }
    return {key: np.asarray(value, float) for key, value in numbers.items()}


@dataclass(frozen=True)
class Exact:
    """The reference, and how far a wrong start leads away from it.

    Attributes:
        path: the exact motion.
        place, speed: deviations [m, m/s] that disturbances cause at each sample, the largest so far.
    """

    path: Path
    place: np.ndarray
    speed: np.ndarray


def exact(laws: Laws, numbers, ts, rtol: float, random) -> Exact:
    """The reference with two disturbed companions, at the first `N_COMPARED` samples."""
    ts = ts[:N_COMPARED]
    path = ball_path(ball(numbers), laws.contact(numbers), ts, MAX_ONSETS, MAX_STEPS)
    size = max(DISTURBANCE * rtol, SMALLEST_DISTURBANCE)
    place, speed = np.zeros(ts.size), np.zeros(ts.size)
    for _ in range(2):
        moved = dict(numbers)
        length = numbers["clearance"]
        pace = _typical_speed(numbers)
        moved["position"] = numbers["position"] + size * length * random.normal(size=3)
        moved["velocity"] = numbers["velocity"] + size * pace * random.normal(size=3)
        moved["spin"] = numbers["spin"] * (1 + size * random.normal(size=3))
        moved["clearance"] = numbers["clearance"] * (1 + size * random.normal())
        other = ball_path(ball(moved), laws.contact(moved), ts, MAX_ONSETS, MAX_STEPS)
        alike = other.n_onsets == path.n_onsets
        place = np.maximum(place, np.linalg.norm(other.position - path.position, axis=1))
        fly = alike & ~path.touching & ~other.touching
        apart = np.linalg.norm(other.velocity - path.velocity, axis=1)
        speed = np.maximum(speed, np.where(fly, apart, 0.0))
    place, speed = (np.maximum.accumulate(np.where(np.isnan(x), np.inf, x)) for x in (place, speed))
    return Exact(path, place + size * length, speed + size * pace)


@cache
def compiled(laws: Laws):
    """(numbers, ts, rtol) -> what `Verdict` reads, one program for all numbers."""

    def outcome(numbers, ts, rtol):
        return read(sj.simulate(laws.scene(numbers), ts, rtol=rtol, max_steps=400_000))

    return jax.jit(outcome)


def read(run, position=None, velocity=None):
    """The histories that are judged; place and velocity of the ball in its socket, of a lone ball its own."""
    memory = run.state.memory
    return {
        "position": run.position("ball") if position is None else position,
        "velocity": run.velocity("ball") if velocity is None else velocity,
        "flies": memory[:, 0] == 0 if memory.shape[-1] else run.penetration("joint") <= 0,
        "energy": run.mechanical_energy,
        "kinetic": run.kinetic_energy,
        "normal_force": run.part("joint", "normal_force"),
        "status": run.status,
        "t_reached": run.t_reached,
        "n_accepted": run.stats.n_accepted,
        "n_onsets": jnp.sum(run.stats.n_onsets),
    }


def single(laws: Laws, numbers, ts, rtol) -> dict[str, np.ndarray]:
    """One run by `sj.simulate`."""
    return jax.tree.map(np.asarray, compiled(laws)(numbers, jnp.asarray(ts), jnp.asarray(rtol)))


@cache
def builder(laws: Laws):
    """The same scene builder each time, so that its program is found again."""
    return partial(_scene_of, laws)


def _scene_of(laws, **numbers):
    return laws.scene(numbers)


def in_lanes(laws: Laws, starts, ts, rtol) -> list[dict[str, np.ndarray]]:
    """Many runs by the lanes of `sj.sweep`."""
    stacked = {key: np.stack([s[key] for s in starts]) for key in starts[0]}
    runs = sj.simulate_many(builder(laws), stacked, jnp.asarray(ts), rtol=jnp.asarray(rtol), max_steps=400_000)
    histories = jax.tree.map(np.asarray, _read_all(runs.trajectories))
    return [jax.tree.map(lambda x, i=i: x[i], histories) for i in range(len(starts))]


_read_all = jax.jit(jax.vmap(read))


@dataclass(frozen=True)
class Verdict:
    """What a run did wrong; all False for a good one.

    Attributes:
        status: how it says that it ended.
        gains: energy beyond that of the start, and beyond the tolerance.
        passes_wall: beyond the surface and in flight.
        disagrees: away from the reference by more than the tolerance explains.
        worst: largest deviation from the reference as a share of what is allowed.
        t_compared: up to where it was compared [s].
    """

    status: int
    gains: bool
    passes_wall: bool
    disagrees: bool
    worst: float
    t_compared: float

    @property
    def is_silently_wrong(self) -> bool:
        """Succeeded, and is wrong."""
        return self.status == sj.Status.SUCCEEDED and (self.gains or self.passes_wall or self.disagrees)


def judge(numbers, ts, rtol: float, run, exact: Exact) -> Verdict:
    """The run of a ball against its reference."""
    return judged(float(numbers["clearance"]), _energy_in_motion(numbers), ts, rtol, run, exact)


def judged(clearance: float, energy: float, ts, rtol: float, run, exact: Exact) -> Verdict:
    """A run against its reference, with the energy in motion [J]."""
    known = np.isfinite(run["energy"])
    penetration = np.linalg.norm(run["position"], axis=1) - clearance
    beyond = known & run["flies"] & (penetration > max(100 * rtol, 1e-7) * clearance)
    # As in tests/hard.py, but by the energy of the start: that of a ball that flies away has no bound. In contact an
    # error of place is one of elastic energy.
    bound = 8 * rtol * (int(run["n_accepted"]) + 10) * energy
    bound = bound + max(100 * rtol, 1e-7) * clearance * run["normal_force"]
    gains = bool(np.any(known & (run["energy"] - run["energy"][0] > bound)))
    path = exact.path
    early = {key: run[key][:N_COMPARED] for key in ("position", "velocity", "flies")}
    allowed = ALLOWED * exact.place
    comparable = known[:N_COMPARED] & np.isfinite(path.position[:, 0]) & (allowed < 0.1 * clearance)
    comparable = np.logical_and.accumulate(comparable)
    off = np.linalg.norm(early["position"] - path.position, axis=1) / allowed
    speed_off = np.linalg.norm(early["velocity"] - path.velocity, axis=1) / (ALLOWED * exact.speed)
    both_fly = comparable & early["flies"] & ~path.touching
    worst = max(np.max(off[comparable], initial=0), np.max(speed_off[both_fly], initial=0))
    last = float(ts[np.flatnonzero(comparable)[-1]]) if comparable.any() else 0.0
    return Verdict(int(run["status"]), gains, bool(beyond.any()), bool(worst > 1), float(worst), last)


def _energy_in_motion(numbers) -> float:
    """Energy that the start can exchange [J]."""
    mass = float(numbers["mass"])
    fall = 2 * float(numbers["clearance"]) * float(np.linalg.norm(numbers["gravity"]))
    spin = float(numbers["inertia"]) * float(numbers["spin"] @ numbers["spin"]) / 2
    return mass * (float(numbers["velocity"] @ numbers["velocity"]) / 2 + fall) + spin
