"""Gradients by many numbers: what they cost in values, and what they take to compile.

    python benchmarks/many_numbers.py                # nine minutes
    python benchmarks/many_numbers.py --one-core     # five minutes: the networks, on one core
    python benchmarks/many_numbers.py --only "dry four-bar, its scene"

A network as a force on a body, 3 s, 31 samples, rtol 1e-7, by all of its weights, and along one direction in them, and
the mean over eight starts by `jax.vmap` and its gradient, as a training takes them; the four-bar, dry and lubricated,
0.2 s, by all numbers of its scene and by all but the exponent of its contact (by that derivatives of Rosenbrock
methods, as the lubricated one has, are not sure), and dry by the weights of a network in its friction law; of the dry
one by its scene eight gradients by `jax.vmap`, too. Each in a process of its own, without a cache: processor time of
the first call, imports not counted, and the shortest of the calls after it, of half a second and 15 calls at least.
"""

import argparse
import os
import subprocess
import sys

from machine import read, use_one_core, write

CODE = """
import sys, time, equinox as eqx, jax, jax.numpy as jnp, spherejax as sj
[getattr(sj, name) for name in sj.__all__]
ts = jnp.linspace(0.0, 3.0, 31)

class Learned(sj.forces.AbstractForce):
    network: sj.Network
    @property
    def body_names(self):
        return ("ball",)
    def wrenches(self, t, motions):
        ball = motions["ball"]
        force = self.network(jnp.stack([ball.position[0], ball.velocity[0]]))
        return {{"ball": sj.forces.Wrench(jnp.stack([force, 0 * force, 0 * force]), jnp.zeros(3))}}

def by_network(width):
    numbers = sj.Network(eqx.nn.MLP(2, "scalar", width, 2, activation=jnp.tanh, key=jax.random.key(1)))
    def square(network, place):
        ball = sj.Body(1.0, (1, 1, 1), position=jnp.stack([place, 0 * place, 0 * place]))
        scene = sj.Scene({{"ball": ball}}, forces={{"law": Learned(network)}}, gravity=(0, 0, 0))
        return jnp.mean(sj.simulate(scene, ts, rtol=1e-7).position("ball")[:, 0] ** 2)
    def loss(network):
        return square(network, 0.5)
    def of_eight(network):
        return jnp.mean(jax.vmap(square, (None, 0))(network, jnp.linspace(0.4, 0.6, 8)))
    loss.of_eight = of_eight
    return loss, numbers

class LearnedFriction(sj.laws.AbstractStaticFriction):
    simulable = True
    network: sj.Network
    def secant(self, speed):
        # Threlfall's law but for a factor between 0.5 and 1.5 by the network.
        features = jnp.stack([jnp.tanh(10 * speed), 10 * speed])
        return sj.laws.Threlfall().secant(speed) * (1 + 0.5 * jnp.tanh(self.network(features)))
    def requirements(self):
        return []

def by_friction():
    numbers = sj.Network(eqx.nn.MLP(2, "scalar", 16, 1, activation=jnp.tanh, key=jax.random.key(1)))
    def loss(network):
        scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=LearnedFriction(network)))
        return sj.simulate(scene, jnp.linspace(0.0, 0.2, 21)).position("rocker")[-1, 2]
    return loss, numbers

def by_scene(model, holds_exponent=False):
    scene = sj.gallery.four_bar(model)
    exponent = lambda scene: scene.joints["coupler_rocker"].model.normal.exponent
    numbers, rest = eqx.partition(scene, lambda leaf: isinstance(leaf, float) or eqx.is_inexact_array(leaf))
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), numbers)
    def loss(numbers):
        whole = eqx.combine(numbers, rest)
        if holds_exponent:
            whole = eqx.tree_at(exponent, whole, exponent(scene))
        return sj.simulate(whole, jnp.linspace(0.0, 0.2, 21)).position("rocker")[-1, 2]
    return loss, numbers

loss, numbers = {case}
ones = jax.tree.map(jnp.ones_like, numbers)
if "{way}" == "rows":
    from spherejax.motion.derivatives import sensitivities
    sensitivities.MANY = 1_000_000
ways = dict(value=loss, gradient=jax.grad(loss), direction=lambda at: jax.jvp(loss, (at,), (ones,))[1])
ways["rows"] = ways["gradient"]
if hasattr(loss, "of_eight"):
    ways |= {{"eight runs": loss.of_eight, "gradient of eight runs": jax.grad(loss.of_eight)}}
if "{way}" == "eight gradients":
    numbers = jax.tree.map(lambda leaf: jnp.stack([leaf * (1 + 1e-6 * i) for i in range(8)]), numbers)
    ways["eight gradients"] = jax.vmap(ways["gradient"])
call = jax.jit(ways["{way}"])
begin = time.process_time()
jax.block_until_ready(call(numbers))
first, taken = time.process_time() - begin, []
while len(taken) < 15 or sum(taken) < 0.5:
    begin = time.perf_counter()
    jax.block_until_ready(call(numbers))
    taken.append(time.perf_counter() - begin)
count = sum(leaf.size for leaf in jax.tree.leaves(numbers))
print(count // 8 if "{way}" == "eight gradients" else count, first, min(taken))
"""

CASES = {
    "network in a force, width 8": "by_network(8)",
    "network in a force, width 32": "by_network(32)",
    "network in a force, width 64": "by_network(64)",
    "network in a force, width 128": "by_network(128)",
    "network in a force, width 256": "by_network(256)",
    "network in a friction law, dry four-bar": "by_friction()",
    "dry four-bar, its scene": "by_scene(sj.Dry(1e-4, friction=sj.Threlfall()))",
    "dry four-bar, its scene but the exponent": "by_scene(sj.Dry(1e-4, friction=sj.Threlfall()), True)",
    "lubricated four-bar, its scene but the exponent": "by_scene(sj.Lubricated(clearance=1e-4, viscosity=0.4), True)",
}

OF_EIGHT = ["eight runs", "gradient of eight runs"]

MORE_WAYS = {
    "lubricated four-bar, its scene but the exponent": ["rows"],
    "dry four-bar, its scene": ["eight gradients"],
    **{f"network in a force, width {width}": OF_EIGHT for width in (8, 32, 64)},
}
"""What else is measured of a case; `rows`: with a row for each number in place of the way back."""


def measured(case: str, way: str) -> tuple[int, float, float]:
    """Count of numbers, processor time of a first call [s], and time of a call [s], in a process of its own."""
    environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
    code = CODE.format(case=CASES[case], way=way)
    done = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    count, first, taken = done.stdout.split()[-3:]
    return int(count), float(first), float(taken)


ON_ONE_CORE = tuple(case for case in CASES if "in a force" in case)
"""Cases whose calls take so little that threads matter."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--one-core", action="store_true", help="networks in a force, on one core")
    parser.add_argument("--only", metavar="CASE", choices=CASES, help="this case; the rows of the others stay")
    arguments = parser.parse_args()
    is_on_one_core = arguments.one_core
    name, command = "many_numbers", "python benchmarks/many_numbers.py"
    if is_on_one_core:  # the processes that are started inherit it
        use_one_core()
        name, command = "many_numbers_on_one_core", f"{command} --one-core"
    cases = ON_ONE_CORE if is_on_one_core else CASES
    rows = []
    for case in cases:
        if arguments.only not in (None, case):
            rows += [row for row in read(name) if row["case"] == case]
            continue
        # Of two processes the faster one: on several cores a value waits for a thread of XLA's, more or less long.
        of_value = min((measured(case, "value") for _ in range(2)), key=lambda measures: measures[-1])
        for way in ("value", "gradient", "direction", *MORE_WAYS.get(case, ())):
            count, first, taken = of_value if way == "value" else measured(case, way)
            rows.append(
                {
                    "case": case, "numbers": count, "what": way, "milliseconds": f"{taken * 1e3:.3f}",
                    "values": f"{taken / of_value[-1]:.1f}", "first_call_s": f"{first:.1f}",
                }
            )  # fmt: skip
            print(rows[-1], flush=True)
    write(name, command, rows)


if __name__ == "__main__":
    main()
