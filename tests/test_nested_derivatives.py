"""Derivatives of derivatives, one nesting a row: each is right, or refused with what to do instead.

Against a closed form: a body on a spring and a damper, x'' = -(k x + c x') / m, whose second derivatives by all three
numbers come of the matrix exponential.
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

TS = np.array([0.0, 0.2, 0.4])
AT = jnp.array([8.0, 0.7, 0.5])
ALONG = jnp.array([1.0, -0.3, 0.5])
MANY = jnp.stack([AT, AT * jnp.array([1.2, 0.9, 1.1])])
REST = 0.2


def place(numbers, **options):
    """Where the body is at the end [m], for stiffness, mass and damping."""
    stiffness, mass, damping = numbers
    body = sj.Body(mass, (1e-3,) * 3, position=(0.5, 0.0, 0.0), velocity=(0.3, 0.0, 0.0))
    spring = sj.SpringDamper(("ground.o", "body"), stiffness=stiffness, damping=damping, free_length=REST)
    points = {"o": (0.0, 0.0, 0.0)}
    scene = sj.Scene({"body": body}, forces={"spring": spring}, gravity=(0.0, 0.0, 0.0), ground_points=points)
    return sj.simulate(scene, TS, rtol=1e-9, **options).position("body")[-1, 0]


def exact(numbers):
    stiffness, mass, damping = numbers
    rates = jnp.stack([jnp.array([0.0, 1.0]), jnp.stack([-stiffness / mass, -damping / mass])])
    return REST + (jax.scipy.linalg.expm(rates * TS[-1]) @ jnp.array([0.5 - REST, 0.3]))[0]


HESSIAN = jax.jacfwd(jax.jacfwd(exact))


def of_many(function):
    """The sum over many runs of a function of each."""
    return lambda scale: jnp.sum(jax.vmap(lambda numbers: function(numbers * scale))(MANY), 0)


ONE = jnp.ones(3)
NESTINGS = {
    "reverse of reverse": lambda f: jax.jacrev(jax.jacrev(f))(AT),
    "vmap of grad of grad": lambda f: jax.vmap(jax.grad(lambda p: jax.grad(f)(p) @ ALONG))(MANY),
    "hessian": lambda f: jax.hessian(f)(AT),
    "jit of hessian": lambda f: jax.jit(jax.hessian(f))(AT),
    "reverse of forward": lambda f: jax.jacrev(jax.jacfwd(f))(AT),
    "forward of forward": lambda f: jax.jacfwd(jax.jacfwd(f))(AT),
    "jvp of grad": lambda f: jax.jvp(jax.grad(f), (AT,), (ALONG,))[1],
    "vjp of jvp": lambda f: jax.vjp(lambda p: jax.jvp(f, (p,), (ALONG,))[1], AT)[1](1.0)[0],
    "jvp of jvp": lambda f: jax.jvp(lambda p: jax.jvp(f, (p,), (ALONG,))[1], (AT,), (ALONG,))[1],
    "grad of grad along": lambda f: jax.grad(lambda p: jax.grad(f)(p) @ ALONG)(AT),
    "grad by one number of grad by another": lambda f: jax.grad(lambda k: jax.grad(lambda m: f((k, m, AT[2])))(AT[1]))(
        AT[0]
    ),
    "vmap of hessian": lambda f: jax.vmap(jax.hessian(f))(MANY),
    "grad of vmap of jacrev": lambda f: jax.grad(lambda s: of_many(jax.jacrev(f))(s) @ ALONG)(ONE),
    "jacfwd of vmap of grad": lambda f: jax.jacfwd(of_many(jax.grad(f)))(ONE),
    "jit of jacrev of vmap of grad": lambda f: jax.jit(jax.jacrev(of_many(jax.grad(f))))(ONE),
    "linearized gradient": lambda f: jax.linearize(jax.grad(f), AT)[1](ALONG),
}
FAST = ("reverse of reverse",)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in FAST)) for n in NESTINGS])
def test_a_nesting_of_derivatives(name):
    nested = NESTINGS[name]
    wanted = nested(exact)
    np.testing.assert_allclose(nested(place), wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver", [sj.solvers.Rodas5P(), sj.solvers.Ros34PW2(), diffrax.Kvaerno5()], ids=["Rodas5P", "W", "Kvaerno5"]
)
@pytest.mark.parametrize("name", ["hessian", "reverse of reverse"])
def test_a_nesting_by_a_stiff_method(solver, name):
    wanted = HESSIAN(AT)
    found = NESTINGS[name](lambda numbers: place(numbers, solver=solver))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def onto_a_stop(stiffness, solver=None):
    up = (0.0, 0.0, 1.0)
    scene = sj.Scene(
        bodies={"falling": sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 0.01))},
        forces={
            "stop": sj.forces.BumpStop(("ground.floor", "falling"), shortest=0.0, stiffness=stiffness, direction=up)
        },
        ground_points={"floor": (0.0, 0.0, 0.0)},
    )
    return sj.simulate(scene, jnp.linspace(0.0, 0.055, 3), solver=solver).ys[-1, 2]


def in_a_socket(clearance, solver=None):
    model = sj.Dry(clearance, normal=sj.LankaraniNikravesh(restitution=0.7))
    ball = sj.Body(0.2, (1e-5,) * 3, velocity=(0.05, 0.01, 0.0), points={"center": (0.0, 0.0, 0.0)})
    joint = sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)
    scene = sj.Scene({"ball": ball}, {"joint": joint}, gravity=(0, 0, 0), ground_points={"socket": (0.0, 0.0, 0.0)})
    return sj.simulate(scene, jnp.array([0.0, 0.003, 0.006]), solver=solver).ys[-1, 0]


@pytest.mark.parametrize("nested", ["hessian", "reverse of reverse", "vmap of grad of grad"])
@pytest.mark.parametrize(("run", "at"), [(onto_a_stop, 1e4), (in_a_socket, 1e-4)])
def test_a_nesting_through_contact_is_refused(run, at, nested):
    derivatives = {
        "hessian": lambda: jax.hessian(run)(at),
        "reverse of reverse": lambda: jax.grad(jax.grad(run))(at),
        "vmap of grad of grad": lambda: jax.vmap(jax.grad(jax.grad(run)))(jnp.array([at, at])),
    }
    with pytest.raises(sj.SceneError, match=r"differences of jax\.grad"):
        derivatives[nested]()


def test_a_nesting_through_a_stop_is_refused_by_stiff_methods_too():
    with pytest.raises(sj.SceneError, match=r"differences of jax\.grad"):
        jax.hessian(lambda stiffness: onto_a_stop(stiffness, sj.solvers.Rodas5P()))(1e4)


@pytest.mark.slow
def test_a_nesting_by_a_stiff_method_is_nan_where_a_ball_touches():
    """A film may never be pressed through, and nobody knows before the run: where it is, there is no number."""
    assert np.isnan(jax.hessian(lambda clearance: in_a_socket(clearance, sj.solvers.Rodas5P()))(1e-4))


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_derivatives_through_many_runs_say_what_to_do(derivative):
    def build(mass):
        return sj.gallery.simple_pendulum(mass=mass)

    def ends(scale):
        many = sj.simulate_many(build, {"mass": scale * np.array([1.0, 2.0])}, TS)
        return many.trajectories.ys[:, -1].sum()

    with pytest.raises(sj.SceneError, match=r"simulate_many gives no derivatives .* by=.* jax\.vmap\(jax\.grad"):
        derivative(ends)(1.0)


def test_a_sweep_takes_numbers():
    def ends(scale):
        values = {"mass": scale * jnp.array([1.0, 2.0])}
        found = sj.sweep(lambda mass: sj.gallery.simple_pendulum(mass=mass), values, TS, record=["final position.bob"])
        return jnp.asarray(found["final_position.bob"].values).sum()

    with pytest.raises(sj.SceneError, match=r"'mass' is traced .* sj\.studies\.Sensitivity"):
        jax.grad(ends)(1.0)
