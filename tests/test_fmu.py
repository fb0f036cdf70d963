"""Scenes as FMUs, run by FMPy: what they say of themselves, what comes out, and what they refuse."""

import ctypes
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import diffrax
import equinox as eqx
import fmpy
import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

import spherejax as sj
from spherejax import cli
from spherejax.compiler.emit.c import PRELUDE
from spherejax.compiler.program import scalarize
from spherejax.motion.runs.pieces import Pieces
from spherejax.output.fmu import native

if not any(map(shutil.which, ("cc", "gcc", "clang"))):
    pytest.skip("no C compiler (Debian: apt-get install gcc)", allow_module_level=True)

MASS, LENGTH = 0.5, 0.3
OUTPUTS = ("position.rod", "reaction.pivot.z", "angular_velocity.rod.y")
PUSH = "forces.push.force.x"


def pendulum(model=None, push=(0.0, 0.0, 0.0)):
    """A rod on a pivot that a force pushes at its center."""
    scene = sj.gallery.physical_pendulum(model, mass=MASS, length=LENGTH)
    return sj.Scene(
        scene.bodies,
        scene.joints,
        {"push": sj.AppliedWrench("rod", push)},
        ground_points=scene.ground_points,
        drift=scene.drift,
    )


DRY = sj.Dry(1e-3, friction=sj.Threlfall(mu=0.1, v1=1e-2))


@pytest.fixture(scope="module")
def ideal(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "pendulum.fmu"
    return sj.export_fmu(pendulum(), path, inputs=PUSH, outputs=OUTPUTS, parameters="bodies.rod.mass")


@pytest.fixture(scope="module")
def dry(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "knocking pendulum.fmu"
    parameters = ["joints.pivot.model.clearance", "gravity.z"]
    return sj.export_fmu(pendulum(DRY), path, outputs=["position.rod.z"], parameters=parameters)


@pytest.fixture
def instance(ideal, tmp_path):
    """A co-simulation by hand, and what it logs."""
    opened = instance_of(ideal, tmp_path)
    yield opened
    opened.slave.freeInstance()


def instance_of(path, folder):
    told = fmpy.read_model_description(path)
    logged = []
    slave = FMU3Slave(
        guid=told.guid,
        unzipDirectory=fmpy.extract(path, folder / "unzipped"),
        modelIdentifier=told.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate(
        logMessage=lambda environment, status, category, message: logged.append(message.decode()), loggingOn=True
    )
    references = {variable.name: variable.valueReference for variable in told.modelVariables}
    return SimpleNamespace(slave=slave, logged=logged, ref=references)


def started(instance):
    instance.slave.enterInitializationMode(startTime=0.0)
    instance.slave.exitInitializationMode()
    return instance


def steps(instance, n, t=0.0, h=0.01):
    for k in range(n):
        instance.slave.doStep(t + k * h, h)
    return instance.slave.getFloat64([instance.ref[f"position.rod.{axis}"] for axis in "xyz"])


def run_by(path, t_end, kind="CoSimulation", **more):
    """By FMPy's master, with six samples: `simulate` compiles once for these."""
    every = {"step_size": t_end / 5, "output_interval": t_end / 5, "record_events": False}
    found = fmpy.simulate_fmu(path, fmi_type=kind, stop_time=t_end, **every, **more)
    assert len(found) == 6
    return found


# What it says of itself -----------------------------------------------------------------------------------------------


def test_description_is_valid(ideal, dry):
    for path in (ideal, dry):
        assert validate_fmu(path) == []


def test_variables_have_units_starts_and_kinds(ideal):
    told = fmpy.read_model_description(ideal)
    known = {variable.name: variable for variable in told.modelVariables}
    assert (known[PUSH].causality, known[PUSH].unit, float(known[PUSH].start)) == ("input", "N", 0.0)
    mass = known["bodies.rod.mass"]
    assert (mass.causality, mass.variability, mass.unit, float(mass.start)) == ("parameter", "fixed", "kg", MASS)
    assert [known[f"position.rod.{axis}"].unit for axis in "xyz"] == ["m"] * 3
    newton = next(unit for unit in told.unitDefinitions if unit.name == "N").baseUnit
    assert (newton.kg, newton.m, newton.s, newton.rad) == (1, 1, -2, 0)
    spin = next(unit for unit in told.unitDefinitions if unit.name == "rad/s").baseUnit
    assert (spin.rad, spin.s, spin.m) == (1, -1, 0)


def test_it_needs_no_python(ideal, tmp_path):
    """The library links to the C library alone."""
    folder = Path(fmpy.extract(ideal, tmp_path))
    library = next((folder / "binaries").rglob("pendulum.*"))
    linked = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    assert "libc.so" in linked
    assert "python" not in linked


def test_another_machine_compiles_the_source(ideal, tmp_path):
    """With `fmpy compile`, of an FMU whose library has been taken out; it then runs as before, to the last bit."""
    if shutil.which("cmake") is None:
        pytest.skip("no CMake (Debian: apt-get install cmake)")
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(ideal) as whole, zipfile.ZipFile(bare, "w") as rest:
        for name in whole.namelist():
            if not name.startswith("binaries/"):
                rest.writestr(name, whole.read(name))
    assert fmpy.supported_platforms(str(bare)) == ["c-code"]
    done = subprocess.run([sys.executable, "-m", "fmpy", "compile", bare], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    again, before = run_by(bare, 0.5), run_by(ideal, 0.5)
    for name in before.dtype.names:
        np.testing.assert_array_equal(again[name], before[name])


# What comes out -------------------------------------------------------------------------------------------------------


def test_co_simulation_reproduces_simulate(ideal):
    found = run_by(ideal, 0.5)
    run = sj.simulate(pendulum(), found["time"])
    for i, axis in enumerate("xyz"):
        np.testing.assert_allclose(found[f"position.rod.{axis}"], run.position("rod")[:, i], rtol=0, atol=1e-8)
    assert found["position.rod.z"][-1] == pytest.approx(pushed_height(0.5), abs=1e-9)
    np.testing.assert_allclose(found["reaction.pivot.z"], run.reaction("pivot")[:, 2], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "solver", [sj.solvers.Dop853(), pytest.param(diffrax.Tsit5(), marks=pytest.mark.slow)], ids=repr
)
def test_co_simulation_by_any_explicit_method(tmp_path, solver):
    """Its stages for states inside a step are left out, and its order is the controller's."""
    path = sj.export_fmu(pendulum(), tmp_path / "pendulum.fmu", inputs=PUSH, outputs=OUTPUTS, solver=solver)
    assert run_by(path, 0.5)["position.rod.z"][-1] == pytest.approx(pushed_height(0.5), abs=1e-9)


def test_model_exchange_reproduces_simulate_to_the_tolerance(ideal):
    errors = []
    for tolerance in (1e-5, 1e-9):
        found = run_by(ideal, 0.5, "ModelExchange", relative_tolerance=tolerance)
        run = sj.simulate(pendulum(), found["time"])
        errors.append(np.abs(found["position.rod.z"] - run.position("rod")[:, 2]).max())
    assert errors[1] < 1e-7
    assert errors[1] < 0.05 * errors[0]


def pushed_height(t_end, force=lambda t: 0.0, mass=MASS):
    """Of the same rod, by hand: its angle below the horizontal, I theta'' = r (m g cos - F sin)."""
    arm = LENGTH / 2
    inertia = float(pendulum().bodies["rod"].inertia[1]) + mass * arm**2

    def slope(t, y):
        return y[1], arm * (mass * 9.81 * np.cos(y[0]) - force(t) * np.sin(y[0])) / inertia

    found = solve_ivp(slope, (0.0, t_end), (0.0, 0.0), rtol=1e-12, atol=1e-14)
    return -arm * np.sin(found.y[0, -1])


def test_a_held_input_costs_the_order_of_the_communication_step(ideal):
    def force(t):
        return 3.0 * np.sin(8.0 * t)

    t_end = 0.4
    z = pushed_height(t_end, force)
    ts = np.linspace(0.0, t_end, 4001)
    signal = np.array([(t, force(t)) for t in ts], [("time", float), (PUSH, float)])

    def co_simulated(**more):
        return fmpy.simulate_fmu(ideal, fmi_type="CoSimulation", stop_time=t_end, input=signal, **more)

    errors = []
    for step in (0.01, 0.005, 0.0025, 0.00125):
        found = co_simulated(output_interval=step)
        errors.append(found["position.rod.z"][-1] - z)
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    np.testing.assert_allclose(ratios, 2.0, atol=0.12)
    assert abs(ratios[-1] - 2.0) < 0.6 * abs(ratios[-2] - 2.0)
    assert abs(z - pushed_height(t_end)) > 20 * abs(errors[-1])
    # FMPy holds inputs over its intervals in model exchange too.
    exchanged = [
        fmpy.simulate_fmu(
            ideal,
            fmi_type="ModelExchange",
            stop_time=t_end,
            output_interval=step,
            input=signal,
            relative_tolerance=1e-9,
        )["position.rod.z"][-1]
        - z
        for step in (0.0025, 0.00125)
    ]
    assert exchanged[0] / exchanged[1] == pytest.approx(2.0, abs=0.2)
    assert abs(exchanged[1]) < 2 * abs(errors[-1])


def test_parameters_change_what_they_change_in_a_scene(ideal):
    found = run_by(ideal, 0.3, start_values={"bodies.rod.mass": 0.8, PUSH: 1.2})
    z = pushed_height(0.3, lambda t: 1.2, mass=0.8)
    assert found["position.rod.z"][-1] == pytest.approx(z, abs=1e-9)
    assert abs(z - pushed_height(0.3, lambda t: 1.2)) > 1e-3


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_contacts_begin_and_end_as_in_simulate(dry, kind):
    """The rod drops onto its socket and rebounds; another clearance is another motion, assembled anew."""
    for clearance in (1e-3, 5e-4):
        found = run_by(
            dry, 0.1, kind, relative_tolerance=1e-9, start_values={"joints.pivot.model.clearance": clearance}
        )
        scene = eqx.tree_at(lambda s: s.joints["pivot"].model.clearance, pendulum(DRY), clearance)
        run = sj.simulate(scene, found["time"])
        assert int(run.stats.n_onsets[0]) >= 2
        np.testing.assert_allclose(found["position.rod.z"], run.position("rod")[:, 2], rtol=0, atol=1e-3 * clearance)


# Again, and from the middle -------------------------------------------------------------------------------------------


def test_states_are_kept_and_set_and_a_reset_begins_anew(instance):
    started(instance)
    steps(instance, 5)
    kept = instance.slave.getFMUState()
    stored = instance.slave.serializeFMUState(kept)
    first = steps(instance, 5, t=0.05)
    instance.slave.setFMUState(kept)
    assert steps(instance, 5, t=0.05) == first
    instance.slave.setFMUState(instance.slave.deserializeFMUState(stored))
    assert steps(instance, 5, t=0.05) == first
    instance.slave.freeFMUState(kept)
    instance.slave.reset()
    started(instance)
    assert steps(instance, 5) != first
    assert steps(instance, 5, t=0.05) == first


def test_two_instances_are_two(ideal, tmp_path, instance):
    other = instance_of(ideal, tmp_path / "other")
    other.slave.setFloat64([other.ref["bodies.rod.mass"]], [2.0])
    started(other), started(instance)
    other.slave.setFloat64([other.ref[PUSH]], [5.0])
    moved, usual = steps(other, 10), steps(instance, 10)
    assert abs(moved[2] - usual[2]) > 1e-4
    other.slave.freeInstance()


# Failures -------------------------------------------------------------------------------------------------------------


def test_illegal_numbers_are_refused_with_a_word(instance):
    instance.slave.setFloat64([instance.ref["bodies.rod.mass"]], [-1.0])
    instance.slave.enterInitializationMode(startTime=0.0)
    with pytest.raises(FMICallException) as refused:
        instance.slave.exitInitializationMode()
    assert refused.value.status == 3
    assert "not valid" in instance.logged[-1]


def test_a_step_that_fails_is_discarded_and_leaves_the_state(instance):
    started(instance)
    before = steps(instance, 3)
    instance.slave.setFloat64([instance.ref[PUSH]], [1e300])
    with pytest.raises(FMICallException) as refused:
        instance.slave.doStep(0.03, 0.01)
    assert refused.value.status == 2
    assert "t = 0.03" in instance.logged[-1]
    instance.slave.setFloat64([instance.ref[PUSH]], [0.0])
    assert instance.slave.getFloat64([instance.ref["time"]]) == [pytest.approx(0.03)]
    assert instance.slave.getFloat64([instance.ref[f"position.rod.{axis}"] for axis in "xyz"]) == before
    assert steps(instance, 1, t=0.03)[2] == pytest.approx(pushed_height(0.04), abs=1e-9)


def test_calls_out_of_turn_are_refused(instance):
    started(instance)
    for call, word in (
        (lambda: instance.slave.doStep(0.5, 0.01), "stands at"),
        (lambda: instance.slave.doStep(0.0, -0.01), "positive"),
        (lambda: instance.slave.setFloat64([instance.ref["bodies.rod.mass"]], [1.0]), "before the start"),
        (lambda: instance.slave.setFloat64([instance.ref["time"]], [1.0]), "cannot be set"),
        (lambda: instance.slave.setFloat64([instance.ref[PUSH]], [np.nan]), "not finite"),
        (lambda: instance.slave.getFloat64([99999]), "no variable"),
        (lambda: instance.slave.getInt32([1]), "no such"),
    ):
        with pytest.raises(FMICallException):
            call()
        assert word in instance.logged[-1]


def test_a_foreign_token_makes_no_instance(ideal, tmp_path):
    slave = FMU3Slave(
        guid="of another", unzipDirectory=fmpy.extract(ideal, tmp_path), modelIdentifier="pendulum", instanceName="one"
    )
    said = []
    with pytest.raises(Exception, match="instantiate"):
        slave.instantiate(logMessage=lambda *words: said.append(words[-1].decode()))
    assert "token" in said[0]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"outputs": "position.rid"}, ["outputs", "position.rid", "position.rod"]),
        ({"outputs": ()}, ["outputs= names nothing"]),
        ({"outputs": "mechanical_energy"}, ["no quantity of one instant"]),
        ({"inputs": "forces.psh.force"}, ["inputs", "psh", "did you mean 'push'"]),
        ({"parameters": "bodies.rod.mas"}, ["parameters", "mass"]),
        ({"inputs": PUSH, "parameters": "forces.push.force"}, [PUSH, "twice"]),
        ({"inputs": "ground_points.pivot.x"}, ["moves a constraint", "parameters="]),
        ({"kind": "matlab"}, ["matlab", "c, python"]),
        ({"path": "pendulum.zip"}, [".fmu"]),
        ({"stop_time": 0.0}, ["stop_time", "positive"]),
        ({"solver": diffrax.Kvaerno5()}, ["Kvaerno5", "leave it out"]),
        ({"rtol": 2.0}, ["rtol"]),
    ],
)
def test_requests_that_make_no_sense(tmp_path, asked, words):
    asked = {"outputs": OUTPUTS, "path": "pendulum.fmu", **asked}
    with pytest.raises(sj.SceneError) as refused:
        sj.export_fmu(pendulum(), tmp_path / asked.pop("path"), **asked)
    for word in words:
        assert word in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_nothing_is_replaced_in_silence_and_a_compiler_is_needed(ideal, tmp_path, monkeypatch):
    with pytest.raises(sj.SceneError, match="exists"):
        sj.export_fmu(pendulum(), ideal, outputs=OUTPUTS)
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(sj.SceneError, match="no C compiler"):
        sj.export_fmu(pendulum(), tmp_path / "a.fmu", outputs=OUTPUTS)


def test_a_users_code_is_not_taken_along(tmp_path):
    scene = pendulum()
    scene = sj.Scene(
        scene.bodies, scene.joints, {"pull": my_laws.Magnet("rod", 1.0)}, ground_points=scene.ground_points
    )
    with pytest.raises(sj.SceneError, match="no code") as refused:
        sj.export_fmu(scene, tmp_path / "a.fmu", outputs=OUTPUTS, kind="python")
    assert 'kind="c"' in str(refused.value)


# The program in C -----------------------------------------------------------------------------------------------------


def test_operations_are_those_of_jax(tmp_path):
    """Every elementwise operation, compiled and called."""

    def every(x, y):
        a, b = x[0], x[1]
        unary = (
            jnp.exp, jnp.exp2, jnp.log1p, jnp.expm1, jnp.tanh, jnp.sin, jnp.cos, jnp.tan, jnp.arcsin, jnp.arccos,
            jnp.arctan, jnp.sinh, jnp.cosh, jnp.arcsinh, jnp.arctanh, jnp.cbrt, jnp.abs, jnp.sign, jnp.floor, jnp.ceil,
            jnp.round, jax.scipy.special.erf, jax.scipy.special.erfc, jax.nn.sigmoid, jnp.sqrt, jnp.log, jax.lax.rsqrt,
        )  # fmt: skip
        found = [function(part) for function in unary for part in (a, b)]
        found += [a + y[0], a - y[1], a * y[0], a / y[1], -a, jnp.maximum(a, y[0]), jnp.minimum(a, y[0])]
        found += [a ** y[0], a**1.5, a**-3, jnp.arctan2(a, y[1]), jnp.arccosh(1 + a), jnp.clip(y[1], -0.3, 0.3)]
        found += [
            jnp.where((a < b) & ~(y[0] >= 2) | (y[1] == 0), a, b),
            jnp.where(jnp.isfinite(y[0] / (y[1] - y[1])), a, b),
        ]
        found += [jax.lax.rem(y[1], a), jnp.nextafter(a, y[0]), jnp.where((a < b) ^ (a != b), 1.0, 2.0)]
        found += [jnp.maximum(jnp.log(-b), a), jnp.minimum(a, jnp.log(-b))]
        return jnp.stack(found)

    program = scalarize(every, *(jax.ShapeDtypeStruct((2,), jnp.float64),) * 2)
    source = f"{PRELUDE}{program.c_source('every')}" + (
        "void run(const double *x, const double *y, double *out) {\n"
        "  double ahead[every_ahead_size + 1];\n  every_ahead(x, ahead);\n  every(ahead, x, y, out);\n}\n"
    )
    (tmp_path / "every.c").write_text(source)
    library = tmp_path / "every.so"
    subprocess.run(
        ["cc", "-std=c11", "-O2", "-fPIC", "-shared", "-o", library, tmp_path / "every.c", "-lm"], check=True
    )
    run = ctypes.CDLL(str(library)).run
    pointer = np.ctypeslib.ndpointer(np.float64)
    run.argtypes = [pointer] * 3
    x, y = np.array([0.31, 0.77]), np.array([0.6, -1.7])
    out = np.zeros(program.n_outputs)
    run(x, y, out)
    np.testing.assert_allclose(out, np.asarray(jax.jit(every)(x, y)), rtol=4e-15)
    assert np.isnan(out[-1])
    assert np.isnan(out[-2])


# Starts and compilers -------------------------------------------------------------------------------------------------


def hurried(speed):
    """A pendulum whose rod is pulled along its own axis, which the pivot does not allow."""
    return eqx.tree_at(lambda s: s.bodies["rod"].velocity, pendulum(), jnp.asarray([0.0, 0.0, speed]))


def left_start(opened):
    """The status that fmi3ExitInitializationMode returns; FMPy raises from fmi3Discard on, and hides warnings."""
    return opened.slave.dll.fmi3ExitInitializationMode(ctypes.c_void_p(opened.slave.component))


def test_a_start_that_the_joints_change_is_told(tmp_path):
    """At the export, and by each instance: the velocity of a parameter that was set counts."""
    with pytest.warns(sj.errors.StartWarning, match="violate the constraint"):
        path = sj.export_fmu(hurried(1.0), tmp_path / "hurried.fmu", outputs=["velocity.rod"], parameters="gravity.z")
    told = instance_of(path, tmp_path)
    told.slave.enterInitializationMode(startTime=0.0)
    assert left_start(told) == 1  # fmi3Warning
    assert "do not allow was removed: rod starts with" in told.logged[-1]
    assert "instead of (0, 0, 1) m/s" in told.logged[-1]
    told.slave.doStep(0.0, 0.01)
    told.slave.freeInstance()


def test_a_start_that_parameters_spoil_is_told(tmp_path):
    scene = hurried(0.0)
    path = sj.export_fmu(scene, tmp_path / "quiet.fmu", outputs=["velocity.rod"], parameters="bodies.rod.velocity.z")
    for speed, status in ((0.0, 0), (1e-3, 1)):
        opened = instance_of(path, tmp_path / str(status))
        opened.slave.setFloat64([opened.ref["bodies.rod.velocity.z"]], [speed])
        opened.slave.enterInitializationMode(startTime=0.0)
        assert left_start(opened) == status
        assert bool(opened.logged) == bool(status)
        opened.slave.freeInstance()


def test_bodies_that_are_moved_are_told(tmp_path):
    parameters = [f"bodies.rod.position.{axis}" for axis in "xyz"]
    path = sj.export_fmu(pendulum(), tmp_path / "moved.fmu", outputs=["position.rod"], parameters=parameters)
    opened = instance_of(path, tmp_path)
    opened.slave.setFloat64([opened.ref[parameters[2]]], [0.1])
    opened.slave.enterInitializationMode(startTime=0.0)
    assert left_start(opened) == 1
    assert "the bodies were moved: rod by" in opened.logged[-1]
    opened.slave.freeInstance()


def recompiled(path, folder, *options, change=lambda source: source):
    """The library of an FMU, compiled anew from its source with other options."""
    unzipped = Path(fmpy.extract(path, folder / "unzipped"))
    library = next((unzipped / "binaries").rglob("*.so"))
    for name in ("model.c", "instance.c"):
        source = unzipped / "sources" / name
        source.write_text(change(source.read_text()))
    command = ["cc", "-O2", "-fPIC", "-shared", *options, "-o", library, unzipped / "sources" / "model.c", "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = fmpy.read_model_description(path)
    logged = []
    slave = FMU3Slave(guid=told.guid, unzipDirectory=unzipped, modelIdentifier=path.stem, instanceName="one")
    return SimpleNamespace(done=done, slave=slave, logged=logged, log=lambda *said: logged.append(said[-1].decode()))


@pytest.mark.parametrize("option", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_fast_math_does_not_compile(ideal, tmp_path, option):
    """A start with NaN was OK where it did."""
    made = recompiled(ideal, tmp_path, option)
    assert made.done.returncode
    assert "compile without -ffast-math" in made.done.stderr


def test_fast_math_that_no_macro_tells_makes_no_instance(ideal, tmp_path):
    made = recompiled(ideal, tmp_path, "-ffast-math", change=lambda source: source.replace("#error", "//"))
    assert made.done.returncode == 0, made.done.stderr
    with pytest.raises(Exception, match="instantiate"):
        made.slave.instantiate(logMessage=made.log, loggingOn=True)
    assert "takes no number for NaN" in made.logged[-1]


def test_products_and_sums_are_not_contracted(ideal, tmp_path):
    """Neither by the options of the export nor, on another machine, by those that ask for it."""
    from spherejax.output.fmu.native import OPTIONS

    assert "-ffp-contract=off" in OPTIONS
    if not Path("/proc/cpuinfo").exists() or "fma" not in Path("/proc/cpuinfo").read_text().split():
        pytest.skip("this processor has no fused multiply-add")
    asked = ("-mfma", "-ffp-contract=fast")
    for number, (change, contracts) in enumerate(
        ((lambda source: source, False), (lambda source: source.replace("#pragma", "//"), True))
    ):
        made = recompiled(ideal, tmp_path / str(number), *asked, change=change)
        assert made.done.returncode == 0, made.done.stderr
        made.slave.instantiate(logMessage=made.log, loggingOn=True)
        assert ("fused multiply-add" in "".join(made.logged)) == contracts
        made.slave.freeInstance()


# Other systems --------------------------------------------------------------------------------------------------------


def named_compiler(folder, answer):
    """A compiler that says what it compiles for, and compiles nothing."""
    if sys.platform == "win32":
        pytest.skip("its stand-in is a script of a POSIX shell")
    script = folder / "cc"
    script.write_text(f"#!/bin/sh\n{answer}\n")
    script.chmod(0o755)
    return str(script)


@pytest.mark.parametrize(
    ("triple", "platform", "suffix"),
    [
        ("x86_64-linux-gnu", "x86_64-linux", ".so"),
        ("x86_64-pc-linux-musl", "x86_64-linux", ".so"),
        ("aarch64-linux-gnu", "aarch64-linux", ".so"),
        ("arm-linux-gnueabihf", "aarch32-linux", ".so"),
        ("i686-linux-gnu", "x86-linux", ".so"),
        ("arm64-apple-darwin23.6.0", "aarch64-darwin", ".dylib"),
        ("x86_64-apple-darwin22.1.0", "x86_64-darwin", ".dylib"),
        ("x86_64-w64-mingw32", "x86_64-windows", ".dll"),
        ("x86_64-pc-windows-msvc", "x86_64-windows", ".dll"),
        ("aarch64-w64-windows-gnu", "aarch64-windows", ".dll"),
    ],
)
def test_the_library_is_named_after_what_the_compiler_compiles_for(triple, platform, suffix, tmp_path):
    target = native.target_of(named_compiler(tmp_path, f"echo {triple}"))
    assert (target.platform, target.suffix) == (platform, suffix)
    # Clang for Windows refuses -fPIC, and has no library m.
    assert ("-fPIC" in target.options) == (suffix != ".dll")
    assert ("-lm" in target.libraries) == ("msvc" not in triple and "windows-gnu" not in triple)


@pytest.mark.parametrize("triple", ["x86_64-pc-cygwin", "sparc64-linux-gnu", "x86_64-unknown-freebsd14"])
def test_a_system_that_fmi_has_no_name_for_is_refused(triple, tmp_path):
    with pytest.raises(sj.SceneError, match=rf"{triple}.*CC"):
        native.target_of(named_compiler(tmp_path, f"echo {triple}"))


@pytest.mark.parametrize("answer", ["exit 1", "echo no such option; exit 0"])
@pytest.mark.parametrize(
    ("machine", "system", "platform"),
    [("AMD64", "win32", "x86_64-windows"), ("arm64", "darwin", "aarch64-darwin"), ("x86_64", "linux", "x86_64-linux")],
)
def test_a_compiler_that_does_not_say_compiles_for_this_machine(
    answer, machine, system, platform, tmp_path, monkeypatch
):
    compiler = named_compiler(tmp_path, answer)
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr(native, "sys", SimpleNamespace(platform=system))
    assert native.target_of(compiler).platform == platform


def numbers_of(path, folder, compiler, *emulator):
    """What the library of an FMU computes in a process of its own system."""
    folder.mkdir()
    unzipped = Path(fmpy.extract(path, folder / "unzipped"))
    (library,) = (each for each in (unzipped / "binaries").rglob("*") if each.is_file())
    host = folder / "host"
    subprocess.run([compiler, "-o", host, Path(__file__).with_name("fmu_host.c"), "-ldl"], check=True)
    told = fmpy.read_model_description(path)
    references = [str(each.valueReference) for each in told.modelVariables if each.causality == "output"]
    command = [*emulator, host, library, told.guid, *references]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return library.parent.name, done.stdout.split()


def test_an_fmu_of_a_cross_compiler_has_the_same_numbers(dry, tmp_path, monkeypatch):
    """On ARM, to the last bit, although fused multiply-add is what GCC makes there by default."""
    compiler, emulator = "aarch64-linux-gnu-gcc", "qemu-aarch64"
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip("no cross compiler (Debian: apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user)")
    monkeypatch.setenv("CC", compiler)
    parameters = ["joints.pivot.model.clearance", "gravity.z"]
    path = sj.export_fmu(
        pendulum(DRY), tmp_path / "knocking pendulum.fmu", outputs=["position.rod.z"], parameters=parameters
    )
    platform, found = numbers_of(path, tmp_path / "arm", compiler, emulator, "-L", "/usr/aarch64-linux-gnu")
    assert platform == "aarch64-linux"
    assert len(found) == 20
    assert found == numbers_of(dry, tmp_path / "here", "cc")[1]


def test_names_are_no_code(tmp_path):
    """A quote ends a text of C."""
    rod = sj.gallery.physical_pendulum(mass=MASS, length=LENGTH).bodies["rod"]
    name = 'r"};int x=1/0;//\\'
    scene = sj.Scene({name: rod}, {}, {"push": sj.AppliedWrench(name, (0.0, 0.0, 0.0))})
    path = sj.export_fmu(scene, tmp_path / "odd.fmu", outputs=[f"position.{name}.z"], parameters=f"bodies.{name}.mass")
    opened = instance_of(path, tmp_path)
    opened.slave.setFloat64([opened.ref[f"bodies.{name}.mass"]], [np.nan])
    opened.slave.enterInitializationMode(startTime=0.0)
    with pytest.raises(FMICallException):
        opened.slave.exitInitializationMode()
    assert f"bodies.{name}.mass is not finite" in opened.logged[-1]
    opened.slave.freeInstance()


# A motion in pieces, and FMUs in Python -------------------------------------------------------------------------------


@pytest.mark.slow
def test_pieces_are_the_whole():
    """A motion with contacts, taken up again and again: memory and the account of energy go on."""
    pieces = Pieces(lambda values: eqx.tree_at(lambda s: s.gravity, pendulum(DRY), jnp.stack([0.0, 0.0, values[0]])),
                    np.array([-9.81]))  # fmt: skip
    y, t = pieces.start(0.0, np.array([-9.81])), 0.0
    for end in np.linspace(0.01, 0.1, 10):
        made = pieces.go_on(t, y, end, np.array([-9.81]))
        assert made.diagnosis == ""
        t, y = made.t, made.y
    run = sj.simulate(pendulum(DRY), np.array([0.0, 0.1]))
    assert int(run.stats.n_onsets[0]) >= 2
    np.testing.assert_allclose(y[:3], run.position("rod")[-1], atol=1e-8)
    with pytest.raises(sj.SceneError, match="does not go on"):
        pieces.go_on(t, y, t, np.array([-9.81]))


@pytest.mark.slow
def test_python_fmu_tells_a_start_that_the_joints_change(tmp_path):
    with pytest.warns(sj.errors.StartWarning):
        path = sj.export_fmu(hurried(1.0), tmp_path / "hurried.fmu", kind="python", outputs=["velocity.rod"])
    opened = started(instance_of(path, tmp_path))
    assert "'pivot' (1 m/s): the velocities given to the bodies violate the constraint" in opened.logged[-1]
    opened.slave.freeInstance()


@pytest.mark.slow
def test_python_fmu_reproduces_simulate_and_says_why_it_stops(tmp_path):
    """Of a film, whose method is stiff; FMPy is its host."""
    film = pendulum(sj.Lubricated(1e-4, viscosity=0.4))
    path = sj.export_fmu(
        film, tmp_path / "film.fmu", kind="python", inputs=PUSH, outputs=OUTPUTS, parameters="bodies.rod.mass"
    )
    assert validate_fmu(path) == []
    inside = zipfile.ZipFile(path).namelist()
    assert "resources/scene.toml" in inside
    assert not [name for name in inside if name.endswith((".pkl", ".pickle"))]
    with pytest.raises(sj.SceneError, match="leave it out"):
        sj.export_fmu(film, tmp_path / "b.fmu", kind="python", outputs=OUTPUTS, solver=diffrax.Dopri8())
    found = run_by(path, 0.06, start_values={"bodies.rod.mass": 0.8, PUSH: 0.5})
    scene = eqx.tree_at(
        lambda s: s.bodies["rod"].mass, pendulum(sj.Lubricated(1e-4, viscosity=0.4), (0.5, 0.0, 0.0)), 0.8
    )
    run = sj.simulate(scene, found["time"])
    assert "Rodas" in run.choice
    np.testing.assert_allclose(found["position.rod.z"], run.position("rod")[:, 2], rtol=0, atol=1e-8)
    opened = instance_of(path, tmp_path)
    started(opened)
    before = steps(opened, 1)
    opened.slave.setFloat64([opened.ref[PUSH]], [1e300])
    with pytest.raises(FMICallException) as refused:
        opened.slave.doStep(0.01, 0.01)
    assert refused.value.status == 2
    assert "stopped at t = 0.01" in opened.logged[-1]
    opened.slave.setFloat64([opened.ref[PUSH]], [0.0])
    assert opened.slave.getFloat64([opened.ref[f"position.rod.{axis}"] for axis in "xyz"]) == before
    opened.slave.freeInstance()


def test_the_command_writes_one(tmp_path, capsys, monkeypatch):
    """What it asks for; the FMU itself is that of the functions."""
    asked = {}

    def export(scene, path, **more):
        asked.update(more, scene=scene)
        return path

    monkeypatch.setattr(sj.runtime, "is_command", lambda: False)
    monkeypatch.setitem(vars(sj), "export_fmu", export)
    words = [
        "--parameter",
        "clearance",
        "--parameter",
        "rocker.mass",
        "--input",
        "gravity.z",
        "--output",
        "position.rocker",
    ]
    path = str(tmp_path / "a.fmu")
    assert cli.main(["export", "four-bar", "--joint", "dry", "--fmu", path, *words, "--step", "2 ms"]) == 0
    assert asked["parameters"] == ["joints.coupler_rocker.model.clearance", "bodies.rocker.mass"]
    assert asked["inputs"] == ["gravity.z"]
    assert (asked["outputs"], asked["step_size"], asked["kind"]) == (["position.rocker"], 2e-3, "c")
    assert f"wrote {path}" in capsys.readouterr().out
    assert cli.main(["export", "four-bar", "--fmu", path, "--output", "x", "--parameter", "rocker.mas"]) == 2
    assert "--parameter" in (told := capsys.readouterr().err)
    assert "mass" in told


def test_an_element_that_samples_is_refused(tmp_path):
    """It would never sample there."""
    control = sj.forces.SampledPID(sj.Turn(("ground", "rotor"), (0, 0, 1)), 0.1, 1.0, 0.01)
    scene = sj.Scene({"rotor": sj.Body(1.0, (1e-3,) * 3)}, forces={"control": control})
    with pytest.raises(sj.SceneError, match="'control' samples at instants of its own"):
        sj.export_fmu(scene, tmp_path / "rotor.fmu", outputs=["control.effort"])


def test_a_spring_that_is_wound_up_counts_its_turns(tmp_path):
    """J angle'' = -k angle from a speed that winds it up by 1.4 turns, by both kinds of FMU."""
    wheel = sj.Body(1.0, (1e-3,) * 3, angular_velocity=(0.0, 0.0, 40.0))
    hinge = sj.Revolute(("ground", "wheel"), (0, 0, 0), (0, 0, 1))
    coil = sj.TorsionalSpring(("ground", "wheel"), (0, 0, 1), 0.02)
    path = tmp_path / "wheel.fmu"
    scene = sj.Scene({"wheel": wheel}, {"hinge": hinge}, {"coil": coil}, gravity=(0, 0, 0))
    sj.export_fmu(scene, path, outputs=["coil.angle"])
    for kind in ("CoSimulation", "ModelExchange"):
        found = run_by(path, 0.7, kind)
        w = np.sqrt(20.0)
        np.testing.assert_allclose(found["coil.angle"], 40.0 / w * np.sin(w * found["time"]), atol=1e-3)
