"""Threads: what one does, other threads and the rest of the process do not feel."""

import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fitting import SENSOR, START, oscillator, seen
from sweeping import hanging, pendulum

import spherejax as sj
from spherejax.files.robots import urdf_elements
from spherejax.motion.integration.widths import block_for
from spherejax.motion.runs.many import batch_settings, many
from spherejax.motion.settings import RunSettings
from spherejax.runtime import interrupts_kept

TS = jnp.linspace(0.0, 0.1, 3)

PATIENCE = 300.0
"""How long one thread waits for another [s]; long, for machines are busy."""


class Meeting:
    """Two threads that are at the same place at the same time, of which the first leaves first."""

    def __init__(self):
        self.both_are_there = threading.Barrier(2)
        self.first_has_left = threading.Event()

    def __call__(self, is_first: bool) -> None:
        self.both_are_there.wait(PATIENCE)
        if not is_first:
            assert self.first_has_left.wait(PATIENCE)


class Stopping(diffrax.PIDController):
    """A controller that calls a function while diffrax's integration is traced."""

    at: object = eqx.field(static=True, default=None)

    def wrap(self, direction):
        """Called once in a trace."""
        self.at()  # pyright: ignore[reportCallIssue]
        return super().wrap(direction)


def process_state():
    """What belongs to the whole process and has been changed by libraries, ours among them."""
    return (eqxi.error_if, list(warnings.filters), sys.stderr, sys.unraisablehook, warnings.showwarning)


def unsorted():
    """Sample times that diffrax refuses while the program runs."""
    term, controller = diffrax.ODETerm(lambda t, y, args: -y), diffrax.ConstantStepSize()
    saveat = diffrax.SaveAt(ts=jnp.array([0.0, 0.9, 0.1]))
    diffrax.diffeqsolve(term, diffrax.Euler(), 0.0, 1.0, 0.5, 1.0, saveat=saveat, stepsize_controller=controller)


def test_traces_at_the_same_time_leave_the_checks_of_diffrax_as_they_are():
    """While two runs are traced side by side, and after them."""
    meeting, before = Meeting(), process_state()

    def in_trace(is_first: bool):
        with pytest.raises(Exception, match=r"saveat.ts must be increasing"), ThreadPoolExecutor(1) as elsewhere:
            elsewhere.submit(unsorted).result()
        meeting(is_first)

    def run(is_first: bool):
        controller = Stopping(rtol=1e-6, atol=1e-8, at=lambda: in_trace(is_first))
        found = sj.simulate(pendulum(jnp.asarray(9.81), jnp.asarray(1.0)), TS, stepsize_controller=controller)
        if is_first:
            meeting.first_has_left.set()
        return found

    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(run, [True, False]))
    np.testing.assert_array_equal(runs[0].ys, runs[1].ys)
    assert process_state() == before
    with pytest.raises(Exception, match=r"saveat.ts must be increasing"):
        unsorted()


def test_fits_and_sweeps_at_the_same_time_are_as_one_after_the_other():
    """With their own pools of threads; a sweep's builder sees diffrax's checks while it is traced."""
    before = process_state()

    def build(tilt):
        assert eqxi.error_if is before[0]
        return pendulum(9.81, tilt)

    def swept(seed):
        rng = np.random.default_rng(seed)
        return sj.sweep(build, {"tilt": rng.uniform(0.5, 1.5, 8)}, TS, record=["final position.bob"], workers=2,
                        chunk=4, progress=False)  # fmt: skip

    def fitted(seed):
        return sj.fit(oscillator, START, seen(seed), noise=SENSOR, starts=2, horizon=sj.studies.Whole(), progress=False)

    alone = [swept(1)["final_position.bob"].values, fitted(0).estimates, swept(2)["final_position.bob"].values]
    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(swept, 1), pool.submit(fitted, 0), pool.submit(swept, 2), pool.submit(fitted, 0)]
        found = [job.result() for job in jobs]
    np.testing.assert_array_equal(found[0]["final_position.bob"].values, alone[0])
    np.testing.assert_array_equal(found[2]["final_position.bob"].values, alone[2])
    for fit in found[1::2]:
        assert fit.estimates == alone[1]
    assert process_state() == before


def test_programs_with_sensitivities_and_of_many_runs_do_not_call_back_into_python():
    """JAX's persistent cache keeps no program that does; that of one run is looked at in `test_automatic`."""

    def height(clearance):
        return sj.simulate(hanging(clearance), TS).position("bob")[-1, 2]

    one = jax.jit(lambda c: jax.jvp(height, (c,), (1.0,))).lower(1e-4).as_text()
    parameters = {"clearance": np.array([1e-4, 2e-4])}
    method = batch_settings(hanging, parameters, RunSettings(max_steps=100), block_for())
    lanes = jax.jit(lambda p: many(hanging, method, p, TS, jnp.ones(2, bool)).trajectories.ys).lower(parameters)
    assert "callback" not in one
    assert "callback" not in lanes.as_text()


def test_only_the_thread_that_can_be_interrupted_listens():
    """Two fits in threads: the hook of the process is nobody's but the main thread's."""
    before, meeting = sys.unraisablehook, Meeting()

    def listen(is_first: bool):
        with interrupts_kept():
            meeting(is_first)
        if is_first:
            meeting.first_has_left.set()

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(listen, [True, False]))
    assert sys.unraisablehook is before
    with interrupts_kept():
        assert sys.unraisablehook is not before
    assert sys.unraisablehook is before


ARM = """<robot name="r"><link name="a"/>
  <link name="b" color="red"><inertial weight="2"><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/><shape/></inertial></link>
  <joint name="j" type="revolute" seen="yes"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""


def test_a_robot_is_read_without_turning_standard_error_away(tmp_path: Path, monkeypatch, capsys):
    """Attributes and elements that the library does not know are left out; other threads go on writing."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    before, seen_there, link = sys.stderr, [], urdf_elements._link

    def looking(made):
        seen_there.append(sys.stderr)
        return link(made)

    monkeypatch.setattr(urdf_elements, "_link", looking)
    assert set(sj.load_urdf(path, ignore=("extensions",)).bodies) == {"b"}
    assert capsys.readouterr().err == ""
    assert sys.stderr is before
    path.write_text(ARM.replace('<mass value="1"/>', '<mass value="1"/><mass value="7"/>'))
    with pytest.raises(sj.SceneError, match=r"link 'b': has more than one <mass>; leave the one that counts"):
        sj.load_urdf(path, ignore=("extensions",))
