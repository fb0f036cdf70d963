"""Random scenes: a structure by one seed, its numbers by another, and what every run of one must obey.

A structure (bodies, joints, models, laws, forces) is what compiling takes; the numbers are traced, so that one program
serves many scenes. Scales are drawn first (lengths 1e-2 to 1 m, masses 1e-3 to 1e3 kg, clearances 1e-5 to 1e-2 of a
length), then numbers around them, so that a scene is consistent with itself.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.motion.integration.audit import CHECKS

GRAVITY = 9.81
N_SAMPLES = 33
MAX_STEPS = 30_000
"""A run that needs more is to say so."""

LARGEST_GAIN = 1e-2
"""Share of the energy in motion beyond which no number of steps explains a gain."""

NORMAL_LAWS = ("Hertz", "HuntCrossley", "LankaraniNikravesh", "Gonthier", "Flores", "ExactRestitution")
FRICTION_LAWS = (None, "Threlfall", "BengisuAkay", "Ambrosio", "BrownMcPhee", "LuGre")
FILMS = ("RadialFilm", "FullFilm")
BOUNDARIES = ("Guembel", "PinkusSternlicht", "Sommerfeld")
KINDS = ("spherical", "spherical", "spherical", "revolute", "universal", "cylindrical", "prismatic", "fixed")
CLOSURES = ("plane", "line", "circle", "distance", "driver", None, None, None)
FORCES = ("spring", "absorber", "stop", "torsion", "tyre", "push", None, None)
MODELS = ("ideal", "dry", "dry", "dry", "dry", "lubricated", "bushing", "matrix")
RUBBER = ("bushing", "vector", "curve", "matrix", "hinge", "cross")
REMEMBERED = ((), (), ("branches",), ("friction",), ("branches", "friction"))
DRIVERS = ("driver", "translation", "position", "distance driver")
STARTS = ("concentric", "flight", "contact")
WITH_SURFACES = ("spherical", "journal", "rim")

JOURNALS = 1000
"""Seeds from here on have journals, parallel or at one rim, where others have dry balls in sockets."""


@dataclass(frozen=True)
class Link:
    """A joint between a body and an earlier one (or the ground), and the model of a spherical one."""

    parent: str
    kind: str
    model: str
    normal: str
    friction: str | None
    boundary: str
    start: str
    film: str = "RadialFilm"
    remembers: tuple[str, ...] = ()

    @property
    def is_contact(self) -> bool:
        """Whether ball and socket can touch."""
        return self.kind in WITH_SURFACES and self.model in ("dry", "lubricated")


@dataclass(frozen=True)
class Structure:
    """What is compiled.

    Attributes:
        seed: that it is made of.
        links: one for each body.
        closure: joins the last body to the ground once more.
        forces: on the last body.
        is_free: whether the first body has no link, and nothing acts from outside.
    """

    seed: int
    links: tuple[Link, ...]
    closure: str | None
    forces: tuple[str, ...]
    is_free: bool

    @property
    def is_active(self) -> bool:
        """Whether something else than the joints, weight and passive elements does work."""
        return self.closure in DRIVERS or "push" in self.forces

    @property
    def has_bristles(self) -> bool:
        """Whether a joint has LuGre's friction, whose bristles a rising normal force stiffens."""
        return any(link.is_contact and link.friction == "LuGre" for link in self.links)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Joints with clearance."""
        return tuple(f"j{i}" for i, link in enumerate(self.links) if link.is_contact and link.model == "dry")

    def __str__(self) -> str:
        return f"structure {self.seed}"


def structure(seed: int) -> Structure:
    """The structure of a seed."""
    random = np.random.default_rng([seed, 1])

    def pick(choices):
        return choices[random.integers(len(choices))]

    # Small ones mostly: compiling grows with the bodies.
    n_bodies = int(random.choice([1, 2, 3, 4], p=[0.45, 0.4, 0.1, 0.05]))
    is_free = n_bodies > 1 and random.uniform() < 0.25
    links = []
    for i in range(n_bodies):
        # Chains mostly, some trees.
        parent = "ground" if i == 0 or (not is_free and random.uniform() < 0.15) else f"b{random.integers(i)}"
        links.append(
            Link(
                parent,
                pick(KINDS),
                pick(MODELS),
                pick(NORMAL_LAWS),
                pick(FRICTION_LAWS),
                pick(BOUNDARIES),
                pick(STARTS),
            )
        )
    # Streams of their own: which film; which rubber, which driver; what rubber remembers.
    films = np.random.default_rng([seed, 3])
    links = [replace(x, film=FILMS[films.integers(2) if x.boundary != "PinkusSternlicht" else 0]) for x in links]
    others = np.random.default_rng([seed, 2])
    links = [replace(x, model=RUBBER[others.integers(len(RUBBER))]) if x.model in RUBBER else x for x in links]
    memories = np.random.default_rng([seed, 4])
    links = [replace(x, remembers=REMEMBERED[memories.integers(len(REMEMBERED))]) for x in links]
    if seed >= JOURNALS:
        kinds = ("journal", "rim")
        links = [replace(x, kind=kinds[others.integers(2)]) if x.is_contact and x.model == "dry" else x for x in links]
    closure = None if is_free else pick(CLOSURES)
    if closure == "driver":
        possible = _drivers_of(links[-1])
        closure = possible[others.integers(len(possible))]
    forces = () if is_free else tuple(sorted({f for f in (pick(FORCES), pick(FORCES)) if f}))
    return Structure(seed, tuple(links), closure, forces, is_free)


def _drivers_of(link: Link) -> tuple[str, ...]:
    """Drivers that a body on such a joint can follow."""
    is_held = link.kind == "spherical" and link.model == "ideal"
    if link.kind == "spherical":
        return ("driver", "distance driver") if is_held else DRIVERS
    return {"cylindrical": ("driver", "translation"), "prismatic": ("translation",)}.get(link.kind, ("driver",))


# Numbers ---------------------------------------------------------------------------------------------------------


def numbers(structure: Structure, seed: int) -> dict[str, np.ndarray]:
    """The numbers of a scene: scales, then what is drawn around them."""
    random = np.random.default_rng([structure.seed, seed])
    n = len(structure.links)

    def spread(low, high, size=None):
        return np.exp(random.uniform(np.log(low), np.log(high), size))

    def directions(size):
        x = random.normal(size=(size, 3))
        return x / np.linalg.norm(x, axis=1, keepdims=True)

    length, mass = spread(1e-2, 1.0), spread(1e-3, 1e3)
    moments = random.uniform(0.6, 1.0, (n, 3))  # any two are larger than the third
    return {
        "length": np.asarray(length),
        "mass": mass * spread(0.3, 3.0, n),
        "moments": moments * 0.05,
        "arm": directions(n) * random.uniform(0.5, 1.0, (n, 1)),
        "quaternion": _unit(random.normal(size=(n, 4))),
        "velocity": random.choice([0.0, 0.3, 3.0]) * random.normal(size=(n, 3)),
        "spin": random.choice([0.0, 0.3, 3.0]) * random.normal(size=(n, 3)),
        "axis": directions(n),
        "offset": directions(n) * random.uniform(0.0, 0.9, (n, 1)),
        "clearance": spread(1e-5, 1e-2, n),
        "depth": spread(1e-3, 0.1, n),
        "restitution": random.uniform(0.2, 0.99, n),
        "mu": random.uniform(0.05, 0.3, n),
        "threshold": spread(1e-2, 0.3, n),
        "film": spread(1.0, 1e3, n),
        "stiffness": spread(1e1, 1e5, n),
        "damping": spread(1e-3, 0.3, n),
        "strength": spread(0.1, 10.0),
        "gravity": np.asarray(0.0 if structure.is_free else random.choice([0.0, GRAVITY, GRAVITY])),
    }


def _unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def duration(values) -> float:
    """Half of the time in which a body falls by a length [s], scaled by `length` alone."""
    return 0.5 * float(np.sqrt(values["length"] / GRAVITY))


# Scenes ----------------------------------------------------------------------------------------------------------


def scene(structure: Structure, **x) -> sj.Scene:
    """The scene of a structure; the numbers may be traced."""
    length = x["length"]
    speed = jnp.sqrt(GRAVITY * length)
    centers, middles = [], []
    for i, link in enumerate(structure.links):
        base = jnp.zeros(3) if link.parent == "ground" else centers[int(link.parent[1:])]
        centers.append(base + length * x["arm"][i])
        middles.append(base + 0.5 * length * x["arm"][i])
    bodies, ground, joints = {}, {"anchor": jnp.zeros(3)}, {}
    points: list[dict] = [{"p": length * 0.3 * x["axis"][i]} for i in range(len(structure.links))]
    turns = (
        [rotation_matrix(jnp.asarray(q)) for q in x["quaternion"]]
        if isinstance(x["quaternion"], np.ndarray)
        else [rotation_matrix(x["quaternion"][i]) for i in range(len(structure.links))]
    )
    for i, link in enumerate(structure.links):
        if structure.is_free and i == 0:
            continue
        clearance = x["clearance"][i] * length
        share = {"concentric": 0.0, "flight": 1.0, "contact": 1.0 / 0.9}[link.start]
        # In contact: beyond the surface by a hundredth of the clearance, along the offset's direction.
        away = x["offset"][i] * share
        if link.start == "contact":
            away = x["axis"][i] * 1.01
        has_gap = link.kind == "spherical" and link.model in ("dry", "lubricated")
        is_apart = has_gap and (link.start == "flight" or (link.start == "contact" and link.model == "dry"))
        ball = middles[i] + (clearance * away if is_apart else 0.0)
        points[i][f"ball{i}"] = turns[i].T @ (ball - centers[i])
        if link.parent == "ground":
            ground[f"socket{i}"] = middles[i]
        else:
            j = int(link.parent[1:])
            points[j][f"socket{i}"] = turns[j].T @ (middles[i] - centers[j])
        joints[f"j{i}"] = _joint(link, i, x, middles[i], length, speed, not is_apart)
    for i in range(len(structure.links)):
        bodies[f"b{i}"] = sj.Body(
            x["mass"][i],
            x["mass"][i] * length**2 * x["moments"][i],
            position=centers[i],
            quaternion=x["quaternion"][i],
            velocity=speed * x["velocity"][i],
            angular_velocity=speed / length * x["spin"][i],
            points=points[i],
        )
    last = f"b{len(structure.links) - 1}"
    place = centers[-1] + turns[-1] @ points[-1]["p"]
    if structure.closure:
        joints["closure"] = _closure(structure.closure, last, x, place, length)
    forces = {name: _force(name, last, x, length, speed) for name in structure.forces}
    gravity = jnp.stack([jnp.zeros(()), jnp.zeros(()), -x["gravity"] * jnp.ones(())])
    return sj.Scene(bodies, joints, forces, gravity=gravity, ground_points=ground)


def _joint(link, i, x, middle, length, speed, concentric):
    pair = (link.parent, f"b{i}")
    across = _across(x["axis"][i])
    if link.kind == "spherical":
        model = _model(link, i, x, length, speed)
        return sj.Spherical(f"{link.parent}.socket{i}", f"b{i}.ball{i}", model, starts_concentric=concentric)
    if link.kind == "journal":
        model, at_rest = _model(link, i, x, length, speed), link.start == "concentric"
        return sj.Revolute(pair, middle, x["axis"][i], model, starts_concentric=at_rest)
    if link.kind == "rim":
        model, at_rest, has_collar = (
            _model(link, i, x, length, speed),
            link.start == "concentric",
            link.film == "FullFilm",
        )
        return sj.joints.Rim(pair, middle, x["axis"][i], model, starts_concentric=at_rest, is_thrust=has_collar)
    if link.kind == "universal":
        return sj.Universal(pair, middle, x["axis"][i], across)
    if link.kind == "fixed":
        return sj.Fixed(pair, middle)
    kind = {"revolute": sj.Revolute, "cylindrical": sj.Cylindrical, "prismatic": sj.Prismatic}[link.kind]
    return kind(pair, middle, x["axis"][i])


def _across(axis):
    """A direction perpendicular to another; axes along x are not drawn."""
    return jnp.cross(jnp.asarray(axis), jnp.array([1.0, 0.0, 0.0]))


def _model(link, i, x, length, speed):
    mass = x["mass"][i]
    if link.model == "ideal":
        return sj.Ideal()
    if link.model in RUBBER:
        stiffness = x["stiffness"][i] * mass * GRAVITY / length
        law = _elastomer(link, i, x, length, stiffness)
        return sj.Bushing(law=law, **_remembered(link, i, x, length, speed, stiffness, law.resists_rotation))
    clearance, radius = x["clearance"][i] * length, 0.1 * length
    stiffness = mass * speed**2 / (x["depth"][i] * clearance) ** 2.5
    law = getattr(sj.laws, link.normal)
    normal = law(stiffness=stiffness) if link.normal == "Hertz" else law(x["restitution"][i], stiffness=stiffness)
    mu, v1 = x["mu"][i], x["threshold"][i] * speed
    friction = {
        None: lambda: None,
        "Threlfall": lambda: sj.Threlfall(mu, v1),
        "BengisuAkay": lambda: sj.BengisuAkay(mu, 1.5 * mu, v1, 1.0 / v1),
        "Ambrosio": lambda: sj.Ambrosio(mu, 0.1 * v1, v1),
        "BrownMcPhee": lambda: sj.BrownMcPhee(mu, 1.5 * mu, v1),
        # Bristles that yield by a tenth of the depth of an impact, damped within the passive range.
        "LuGre": lambda: sj.LuGre(mu, 1.5 * mu, v1, 10 * mu / (x["depth"][i] * clearance), 4.0 * mu / v1),
    }[link.friction]()
    if link.model == "dry":
        return sj.Dry(clearance, socket_radius=radius, normal=normal, friction=friction)
    rate = x["film"][i] * speed / length
    viscosity = rate * mass / (4 * jnp.pi * radius * (radius / clearance) ** 3)
    width = 0.02 * clearance
    return sj.Lubricated(
        clearance,
        viscosity,
        socket_radius=radius,
        normal=normal,
        friction=friction,
        e_h0=width,
        e_h1=2 * width,
        boundary=getattr(sj.laws, link.boundary)(),
        film=getattr(sj.laws, link.film)(),
    )


def _elastomer(link, i, x, length, stiffness):
    damping = x["damping"][i] * jnp.sqrt(x["mass"][i] / stiffness)
    turning = stiffness * (0.1 * length) ** 2
    if link.model == "bushing":
        return sj.laws.RadialElastomer(stiffness, damping)
    if link.model == "vector":
        return sj.laws.VectorElastomer(stiffness, damping)
    if link.model == "curve":
        bends = jnp.array([0.01, 0.03, 0.1])
        return sj.laws.CurveElastomer(bends * length, bends * length * stiffness * (1 + 10 * bends), damping)
    across = jnp.diag(jnp.array([1.0, 1.0, 0.3])) * stiffness
    if link.model == "hinge":
        return sj.laws.HingeElastomer(across, damping * across, turning, damping * turning)
    if link.model == "cross":
        return sj.laws.CrossElastomer(across, damping * across, turning, damping * turning)
    return sj.laws.MatrixElastomer.cylindrical(
        x["axis"][i],
        radial_stiffness=stiffness,
        axial_stiffness=0.3 * stiffness,
        conical_stiffness=turning,
        torsional_stiffness=0.3 * turning,
        damping=damping,
    )


def _remembered(link, i, x, length, speed, stiffness, turns):
    """Branches half as stiff as the elastomer; friction as stiff, up to a share of the weight."""
    found, lever = {}, 0.1 * length
    if "branches" in link.remembers:
        k, time = 0.5 * stiffness, length / (x["film"][i] * speed)
        of_turning = jnp.stack([k * lever**2, 0.3 * k * lever**2]) if turns else None
        found["branches"] = sj.laws.Maxwell(jnp.stack([k, 0.3 * k]), jnp.stack([time, 0.1 * time]), of_turning)
    if "friction" in link.remembers:
        limit = x["mu"][i] * x["mass"][i] * GRAVITY
        half = limit / stiffness
        of_turning = (limit * lever, half / lever) if turns else (None, None)
        found["friction"] = sj.laws.Berg(limit, half, *of_turning)
    return found


def _closure(kind, last, x, place, length):
    axis = x["axis"][-1]
    if kind == "plane":
        return sj.joints.PointOnPlane(f"{last}.p", place, axis)
    if kind == "line":
        return sj.joints.PointOnCurve(f"{last}.p", sj.joints.Line(place, axis))
    if kind == "circle":
        across = _across(axis)
        across = across / jnp.sqrt(across @ across)
        return sj.joints.PointOnCurve(f"{last}.p", sj.joints.Circle(place + 0.5 * length * across, axis, 0.5 * length))
    if kind == "distance":
        return sj.joints.Distance("ground.anchor", f"{last}.p")
    rate = jnp.sqrt(GRAVITY / length)
    ends = ("ground", last)
    if kind == "translation":
        return sj.TranslationDriver(ends, place, axis, Swing(0.0, 0.1 * length, rate))
    if kind == "position":
        return sj.joints.PositionDriver(f"{last}.p", Swing(place, 0.1 * length * axis, rate))
    if kind == "distance driver":
        away = jnp.sqrt(place @ place)
        return sj.joints.DistanceDriver("ground.anchor", f"{last}.p", Swing(away, 0.1 * away, rate))
    return sj.RotationDriver(ends, axis, sj.functions.Sine(0.2, rate / (2 * jnp.pi)))


class Swing(sj.functions.AbstractFunction):
    """center + amplitude sin(rate t), of a number or of three."""

    center: jax.Array
    amplitude: jax.Array
    rate: jax.Array

    def __call__(self, x):
        return self.center + self.amplitude * jnp.sin(self.rate * x)


def _force(kind, last, x, length, speed):
    mass = jnp.sum(x["mass"])
    stiffness = x["strength"] * mass * GRAVITY / length
    damping = 0.1 * mass * speed / length
    ends = ("ground.anchor", f"{last}.p")
    return {
        "spring": lambda: sj.SpringDamper(ends, stiffness, damping, 0.5 * length),
        "absorber": lambda: sj.forces.ShockAbsorber(
            ends, sj.functions.Linear(damping), sj.functions.Linear(3 * damping), spring=sj.functions.Linear(stiffness)
        ),
        "stop": lambda: sj.forces.BumpStop(
            ends, longest=length, stiffness=100 * stiffness, damping=damping, onset=0.05 * length
        ),
        "torsion": lambda: sj.TorsionalSpring(
            ("ground", last), (0.0, 0.0, 1.0), stiffness * length**2 * 0.1, damping * length**2 * 0.1
        ),
        "tyre": lambda: sj.forces.Tyre(f"{last}.p", length, 30 * stiffness, damping, 0.05 * length),
        "push": lambda: sj.AppliedWrench(last, force=mass * GRAVITY * jnp.asarray(x["axis"][0])),
    }[kind]()


# Runs ------------------------------------------------------------------------------------------------------------


@cache
def builder(structure: Structure) -> Callable[..., sj.Scene]:
    """The same builder each time, so that its program is found again."""
    return partial(scene, structure)


def stacked(structure: Structure, seeds) -> dict[str, np.ndarray]:
    """Numbers of many scenes with a leading axis; all get the length of the first, and so one duration."""
    each = [numbers(structure, seed) for seed in seeds]
    for values in each:
        values["length"] = each[0]["length"]
    return {key: np.stack([values[key] for values in each]) for key in each[0]}


def histories(run) -> dict[str, jnp.ndarray]:
    """What is judged of one run."""
    state = run.state
    turns = jax.vmap(jax.vmap(rotation_matrix))(state.quaternion)
    masses = jnp.stack([jnp.asarray(body.mass) for body in run.system.bodies.values()])
    inertias = jnp.stack([jnp.asarray(body.inertia) for body in run.system.bodies.values()])
    momentum = masses[:, None] * state.velocity
    spin = jnp.einsum("nbij,bj,nbkj,nbk->nbi", turns, inertias, turns, state.angular_velocity)
    contact = {name: part for name, part in run.observation.parts.items() if "normal_force" in part}
    return {
        "ys": run.ys,
        "status": run.status,
        "t_reached": run.t_reached,
        "n_accepted": run.stats.n_accepted,
        "energy": run.mechanical_energy,
        "supplied": run.supplied_work,
        "is_supply_known": run.stats.audit[0] >= 0,
        "audit": run.stats.audit,
        # By elements that may add energy: what they store counts as taken.
        "stored": sum(
            (run.force(name)["potential_energy"] for name, f in run.system.forces.items() if not f.never_adds_energy),
            jnp.zeros(run.ts.shape),
        ),
        "kinetic": run.kinetic_energy,
        "violation": run.constraint_violation,
        "norm": jnp.max(jnp.abs(jnp.sum(state.quaternion**2, -1) - 1), -1),
        "linear": jnp.sum(momentum, 1),
        "angular": jnp.sum(jnp.cross(state.position, momentum) + spin, 1),
        "press": sum((jnp.abs(part["normal_force"]) for part in contact.values()), jnp.zeros(run.ts.shape)),
        "through": jnp.max(jnp.stack([_through(run, name, part) for name, part in contact.items()]), 0)
        if contact
        else jnp.zeros(run.ts.shape),
    }


def _through(run, name, part):
    """How far a ball is outside of its socket without being pressed back, in clearances."""
    outside = part["penetration"] / run.clearance(name)
    return jnp.where(part["normal_force"] == 0, outside, 0.0)


_all_histories = jax.jit(jax.vmap(histories))


def in_lanes(structure: Structure, values, ts, rtol) -> dict[str, np.ndarray]:
    """Histories of many scenes, by the lanes of `sj.sweep`."""
    runs = sj.simulate_many(builder(structure), values, jnp.asarray(ts), rtol=rtol, max_steps=MAX_STEPS)
    return jax.tree.map(np.asarray, _all_histories(runs.trajectories))


@cache
def _compiled(structure: Structure):
    def one(values, ts, rtol):
        return histories(sj.simulate(scene(structure, **values), ts, rtol=rtol, max_steps=MAX_STEPS))

    return jax.jit(one), jax.jit(jax.vmap(one, (0, None, None)))


def compiled(structure: Structure, values, ts, rtol) -> dict[str, np.ndarray]:
    """Histories of one scene, by `jax.jit` of `simulate`."""
    return jax.tree.map(np.asarray, _compiled(structure)[0](values, jnp.asarray(ts), rtol))


def known(structure: Structure, values, ts, rtol) -> dict[str, np.ndarray]:
    """Histories of many scenes, each by `simulate` of known numbers."""
    found = []
    for k in range(len(values["strength"])):
        one = scene(structure, **{key: value[k] for key, value in values.items()})
        with warnings.catch_warnings():
            # Drawn velocities do not obey the joints.
            warnings.simplefilter("ignore", sj.errors.StartWarning)
            found.append(histories(sj.simulate(one, ts, rtol=rtol, max_steps=MAX_STEPS)))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


VARIED = ("mass", "clearance", "restitution", "mu", "film", "stiffness", "damping", "strength")
"""Numbers along which motions are differentiated."""


def end(structure: Structure, change, values, ts, rtol) -> jnp.ndarray:
    """The last position and quaternion of the last body, after a change of all of `VARIED` together."""
    random = np.random.default_rng([structure.seed, 3])
    ways = {key: random.uniform(-1.0, 1.0, np.shape(values[key])) for key in VARIED}
    changed = {key: values[key] * (1 + change * way) for key, way in ways.items()}
    run = sj.simulate(scene(structure, **{**values, **changed}), ts, rtol=rtol)
    return jnp.concatenate([run.state.position[-1, -1], values["length"] * run.state.quaternion[-1, -1]])


def mapped(structure: Structure, values, ts, rtol) -> dict[str, np.ndarray]:
    """Histories of many scenes, by `jax.vmap` of `simulate`."""
    return jax.tree.map(np.asarray, _compiled(structure)[1](values, jnp.asarray(ts), rtol))


# What every run must obey ----------------------------------------------------------------------------------------


def faults(structure: Structure, values, ts, rtol: float, run) -> list[str]:
    """What is wrong with a run that says how it ended; empty for a good one."""
    found = []
    status = sj.Status(int(run["status"]))
    finite = np.isfinite(run["ys"]).all(1)
    if status == sj.Status.SUCCEEDED and not finite.all():
        found.append("succeeded with NaN")
    if status == sj.Status.BAD_VALUE:
        found.append(f"{status.name}: a legal scene is refused")
    # A spring about an axis between bodies that tumble has no angle where the axis tips over, and the run says so.
    is_angle_undefined = run["audit"][CHECKS.index("turns")] > 1 and run["audit"][CHECKS.index("axes")] > 1
    if status == sj.Status.AUDIT_FAILED and not is_angle_undefined:
        found.append(f"{status.name} at t = {float(run['t_reached']):.3g}: the run found itself wrong")
    if status != sj.Status.START_NOT_CLOSED and not finite[ts <= run["t_reached"]].all():
        found.append(f"NaN before t_reached ({status.name})")
    counts = finite & (ts <= run["t_reached"])
    if status in (sj.Status.START_NOT_CLOSED, sj.Status.BAD_VALUE) or not counts.any():
        return found
    # A run that was stopped is judged as far as it came.
    run = {key: value[counts] if np.shape(value)[:1] == counts.shape else value for key, value in run.items()}
    n, length = len(structure.links), float(values["length"])
    mass = float(values["mass"].sum())
    speed2 = GRAVITY * length
    clearance = float(np.min(values["clearance"])) * length
    motion = float(run["kinetic"][0]) + n * mass * float(values["gravity"]) * length + abs(float(run["energy"][0]))
    motion += 1e-6 * mass * speed2  # of a scene that rests
    steps = int(run["n_accepted"]) + 10
    # Of a scene that nothing drives the whole energy is judged; else that of the parts that never add any. Of bristles
    # the work that is put in is all that passes through their joint.
    supplied, stored = 0.0, 0.0
    if structure.is_active:
        supplied, stored = run["supplied"], run["stored"]
    if not structure.is_active or (run["is_supply_known"] and not structure.has_bristles):
        place = min(length, 1e4 * clearance)
        bound = 100 * rtol * (steps * motion + place * run["press"]) + 1e-12 * mass * speed2
        bound = np.minimum(bound, LARGEST_GAIN * (motion + place * run["press"]))
        bound = bound + 100 * rtol * np.max(np.abs(supplied))
        energy = run["energy"] - stored
        rise = energy - energy[0] - supplied
        gain = rise - bound
        if np.max(gain) > 0:
            share = np.max(rise) / motion
            found.append(f"gained {share:.2g} of the energy in motion by t = {ts[np.argmax(gain)]:.3g}")
    # Impacts are drawn no deeper than a tenth of the clearance at a typical speed; a force that is clipped at zero
    # while the surfaces part is zero only inside of that.
    if np.max(run["through"]) > 0.5:
        found.append(f"through the wall by {np.max(run['through']):.2g} clearances")
    if np.max(run["norm"]) > 1e-6 + 1e3 * rtol:
        found.append(f"quaternion norm off by {np.max(run['norm']):.2g}")
    reach = n * length
    if np.max(run["violation"]) > 1e-9 * reach + 1e3 * rtol * reach + 1e3 * rtol:
        found.append(f"constraints violated by {np.max(run['violation']):.2g}")
    if structure.is_free:
        total = np.sqrt(2 * mass * motion)
        for kind, size in (("linear", total), ("angular", total * reach)):
            drift = np.abs(run[kind] - run[kind][0]).max()
            if drift > 10 * rtol * steps * size + 1e-12 * size:
                found.append(f"{kind} momentum drifts by {drift / size:.2g}")
    return found
