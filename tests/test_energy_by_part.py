"""Energies by part: put in, stored, lost; against integrated works, closed forms, and each other."""

import numpy as np
import pytest

import spherejax as sj


def test_a_spring_and_a_damper_lose_what_the_closed_form_says():
    """A mass on a spring with a damper, set free: all of the spring's energy is lost by the damper's element."""
    m, k, c, x0 = 2.0, 800.0, 16.0, 0.1
    body = sj.Body(m, (0.1,) * 3, position=(x0, 0.0, 0.0), points={"hook": (0.0, 0.0, 0.0)})
    guide = sj.Prismatic(("ground", "cart"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    coordinate = sj.Travel(("ground", "cart"), (1.0, 0.0, 0.0))
    forces = {
        "spring": sj.SpringDamper(("ground.wall", "cart.hook"), k, 0.0, 1.0),
        "damper": sj.SpringDamper(("ground.wall", "cart.hook"), 0.0, c, 1.0),
        "motor": sj.Actuator(coordinate, 3.0),
    }
    scene = sj.Scene({"cart": body}, {"guide": guide}, forces, ground_points={"wall": (-1.0, 0.0, 0.0)})
    run = sj.simulate(scene, np.linspace(0.0, 6.0, 3))
    found = run.energy_by_part
    # Long after: the cart rests where spring and motor balance, at 3/k.
    end = 3.0 / k
    put_in, stored = 3.0 * (end - x0), 0.5 * k * (end**2 - x0**2)
    assert float(found.put_in["motor"][-1]) == pytest.approx(put_in, rel=1e-6)
    assert float(found.stored["spring"][-1]) == pytest.approx(stored, rel=1e-6)
    assert float(found.lost["damper"][-1]) == pytest.approx(put_in - stored, rel=1e-6)
    # Gauss's rule is of order 8 at the ends of steps; to instants inside of them the powers are cubics.
    assert abs(found.lost["spring"][::5]).max() < 1e-6 * abs(stored)
    assert abs(found.lost["spring"]).max() < 1e-4 * abs(stored)
    assert abs(found.unaccounted[::5]).max() < 1e-6 * abs(stored)
    # A loss only grows.
    assert np.diff(found.lost["damper"][::5]).min() > -1e-9
    assert np.all(np.diff(found.ts) > 0)
    figure = sj.plot.energy_by_part(found)
    assert [ax.get_ylabel() for ax in figure.axes] == ["put in [J]", "stored [J]", "lost [J]"]


def test_joints_lose_what_their_integrated_work_says():
    """Impacts in a dry joint, seen between three samples, against the work that the run itself has integrated."""
    run = sj.simulate(sj.gallery.four_bar(sj.Dry(1e-3)), np.linspace(0.0, 0.05, 3), track_work=True)
    found = run.energy_by_part
    lost = float(run.dissipated_energy("coupler_rocker")[-1])
    assert lost > 1e-4
    assert float(found.lost["coupler_rocker"][-1]) == pytest.approx(lost, rel=1e-4)
    assert abs(found.unaccounted[-1]) < 1e-4 * lost


def test_a_driver_puts_in_what_the_bodies_have():
    """A flywheel that a driver brings to 3 rad/s: half J w^2 is put in, and stored in the motion."""
    wheel = sj.Body(1.0, (0.5, 0.5, 0.5))
    joints = {
        "axle": sj.Revolute(("ground", "wheel"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        "drive": sj.RotationDriver(("ground", "wheel"), (0.0, 0.0, 1.0), sj.functions.Polynomial([0.0, 0.0, 1.5])),
    }
    found = sj.simulate(sj.Scene({"wheel": wheel}, joints), np.linspace(0.0, 1.0, 3)).energy_by_part
    assert float(found.put_in["drive"][-1]) == pytest.approx(0.5 * 0.5 * 3.0**2, rel=1e-6)
    assert float(found.stored["kinetic energy"][-1]) == pytest.approx(0.5 * 0.5 * 3.0**2, rel=1e-6)
    assert found.lost == {}


def test_the_report_has_the_balance_as_figure_and_table(tmp_path):
    """With the sum of each column; nobody reads of a class or of a negative loss."""
    bar = sj.Body(1.0, (0.1,) * 3, position=(0.5, 0.0, 0.0))
    pivot = sj.Revolute(("ground", "bar"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    motor = sj.PID(sj.Turn(("ground", "bar"), (0.0, 1.0, 0.0)), 0.2, 20.0, 1.0, 2.0)
    path = tmp_path / "run.html"
    sj.simulate(sj.Scene({"bar": bar}, {"pivot": pivot}, {"motor": motor}), np.linspace(0.0, 0.2, 20)).report(path)
    text = path.read_text(encoding="utf-8")
    for said in ("Energy by part", "put in [", "stored [", "all together", "unaccounted for"):
        assert said in text
    assert "PlacedPair" not in text
