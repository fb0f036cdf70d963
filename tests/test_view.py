"""The interactive view, in a notebook's kernel and without its libraries; no browser takes part."""

import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]

START = """
import jax.numpy as jnp
import numpy as np
import spherejax as sj
run = sj.simulate(sj.gallery.four_bar(sj.Dry(clearance=1e-4)), jnp.linspace(0.0, 0.02, 21), rtol=1e-6)
"""

SHOW = "viewer = sj.view(run)\nviewer"

USE = """
from matplotlib.backend_bases import MouseEvent

from spherejax.output.plot.camera import camera_from

def ring():
    patches = viewer.sheet.figure.axes[0].patches
    outline = next(p for p in patches if p.get_gid() == "joint:crank_coupler").get_path().vertices
    return 0.5 * (outline.min(axis=0) + outline.max(axis=0))

def expected(sample, azimuth, elevation):
    # the crank turns about x at the origin, and its pin is 20 mm from there
    p = np.asarray(run.quaternion("crank")[sample])
    angle = 2 * np.arctan2(p[1], p[0])
    pin = 0.020 * np.array([0.0, -np.sin(angle), np.cos(angle)])
    return camera_from(azimuth, elevation, np.array([0, 0, -9.81])).project(pin)

viewer.turning.turn(30.0, 10.0)
np.testing.assert_allclose(ring(), expected(0, 30.0, 10.0), atol=1e-9)
viewer.slider.value = 300
assert viewer.sheet.figure.get_suptitle() == "t = 0.0200 s"
assert viewer.seconds.value == "0.0200 s of 0.02 s"
assert viewer.seconds in viewer.widget.children[1].children
np.testing.assert_allclose(ring(), expected(20, 30.0, 10.0), atol=1e-9)

# a drag of 50 pixels to the right turns the mechanism with the mouse
canvas, box = viewer.canvas, viewer.sheet.figure.axes[0].get_window_extent()
x, y = box.x0 + 50, box.y0 + 100
for name, at in (("button_press_event", x), ("motion_notify_event", x + 50), ("button_release_event", x + 50)):
    canvas.callbacks.process(name, MouseEvent(name, canvas, at, y, 1))
assert viewer.turning.azimuth == 30.0 - 0.4 * 50
np.testing.assert_allclose(ring(), expected(20, 10.0, 10.0), atol=1e-9)
canvas.callbacks.process("motion_notify_event", MouseEvent("motion_notify_event", canvas, x, y))
assert viewer.turning.azimuth == 10.0, "the mouse is up"

# from every side everything is inside
for azimuth in range(0, 360, 40):
    viewer.turning.turn(azimuth, 25.0)
    ax = viewer.sheet.figure.axes[0]
    drawn = np.concatenate([p.get_path().vertices for p in ax.patches])
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    assert ax.get_xlim()[0] < drawn[:, 0].min() and drawn[:, 0].max() < ax.get_xlim()[1]
    assert ax.get_ylim()[0] < drawn[:, 1].min() and drawn[:, 1].max() < ax.get_ylim()[1]
"""


def test_a_cell_shows_a_widget_that_slides_and_turns(monkeypatch):
    pytest.importorskip("ipympl", reason="of the extra notebooks")
    monkeypatch.setenv("SPHEREJAX_QUIET", "1")  # what is compiled would be said below the widget
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in (START, SHOW, USE)])
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(ROOT)}}).execute()
    (shown,) = notebook.cells[1].outputs
    assert "application/vnd.jupyter.widget-view+json" in shown.data


def test_without_its_libraries_it_is_a_picture_and_names_the_remedy():
    code = """
import sys, warnings
sys.modules["ipympl"] = None
import spherejax as sj
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    shown = sj.view(sj.gallery.four_bar())
print(told[-1].message)
print(shown._repr_png_()[:4] == b"\\x89PNG")
"""
    environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
    seen = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert "pip install 'spherejax[notebooks]'" in seen.stdout
    assert seen.stdout.strip().endswith("True")
