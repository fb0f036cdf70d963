"""A run in a notebook: slide the time, play, turn the mechanism with the mouse. Works without the web.

The figure is that of `spherejax.draw` on ipympl's canvas; the slider is of ipywidgets. Both bring their scripts along.
"""

import io
import warnings
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from spherejax.output.plot.camera import Camera, camera_from, world_directions
from spherejax.output.plot.mechanism import Mechanism
from spherejax.output.plot.sheet import Sheet, Wishes
from spherejax.output.plot.space import poses_of

N_STEPS = 300
"""Steps of the slider: about as many as it has pixels."""

FRAME = 50
"""Time between two frames of the player [ms]: what a canvas with a few hundred kilobytes a frame follows."""

DEGREES_PER_PIXEL = 0.4
"""How far a drag of the mouse turns the view."""


class Still:
    """A picture in place of the interactive view; notebooks show it.

    Attributes:
        figure: the picture.
    """

    def __init__(self, figure: Figure):
        self.figure = figure

    def _repr_png_(self) -> bytes:
        """What a notebook shows."""
        data = io.BytesIO()
        self.figure.savefig(data, format="png")
        return data.getvalue()


def view_of(mechanism: Mechanism, wishes: Wishes, dpi: float) -> "Viewer | Still":
    """The interactive view; `spherejax.view` explains the arguments."""
    poses = poses_of(mechanism)
    sheet = Sheet(mechanism, [*poses, poses[0]], wishes, dpi=dpi, turns=True)
    try:
        return Viewer(sheet)
    except ImportError as error:
        warnings.warn(
            f"the interactive view needs ipympl and ipywidgets ({error}): pip install 'spherejax[notebooks]' and start "
            "the notebook again. Here is a picture of the start",
            UserWarning,
            stacklevel=3,
        )
        return Still(sheet.figure)


class Turning:
    """Turns the spatial view of a sheet while the mouse is dragged in it."""

    def __init__(self, sheet: Sheet):
        self.sheet = sheet
        self.azimuth, self.elevation = angles_of(sheet.views[0].camera, sheet.mechanism.gravity)
        self._from: tuple[float, float] | None = None
        canvas = sheet.figure.canvas
        canvas.mpl_connect("button_press_event", self._press)
        canvas.mpl_connect("button_release_event", self._release)
        canvas.mpl_connect("motion_notify_event", self._drag)

    def turn(self, azimuth: float, elevation: float) -> None:
        """Look from azimuth and elevation [deg]."""
        self.azimuth, self.elevation = azimuth, float(np.clip(elevation, -90.0, 90.0))
        space = self.sheet.views[0]
        space.camera = camera_from(self.azimuth, self.elevation, self.sheet.mechanism.gravity)
        space.fit()
        self.sheet.update(self.sheet.pose)
        self.sheet.figure.canvas.draw_idle()

    def _press(self, event) -> None:
        toolbar = getattr(getattr(self.sheet.figure.canvas, "manager", None), "toolbar", None)
        if event.inaxes is self.sheet.views[0].ax and not getattr(toolbar, "mode", ""):
            self._from = (event.x, event.y)

    def _release(self, event) -> None:
        del event
        self._from = None

    def _drag(self, event) -> None:
        if self._from is None:
            return
        across, along = event.x - self._from[0], event.y - self._from[1]
        self._from = (event.x, event.y)
        self.turn(self.azimuth - DEGREES_PER_PIXEL * across, self.elevation - DEGREES_PER_PIXEL * along)


def angles_of(camera: Camera, gravity: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation of a camera [deg]."""
    first, second, up = world_directions(gravity)
    toward = camera.toward
    elevation = np.degrees(np.arcsin(np.clip(toward @ up, -1.0, 1.0)))
    return float(np.degrees(np.arctan2(toward @ second, toward @ first))), float(elevation)


class Viewer:
    """What `spherejax.view` returns; notebooks show it.

    Attributes:
        sheet: what is drawn.
        turning: turns the spatial view; `viewer.turning.turn(azimuth, elevation)` does so without the mouse.
        slider: the time as a step from 0 to `N_STEPS`.
        seconds: the same in seconds, beside the slider.
        widget: canvas, player and slider.
    """

    def __init__(self, sheet: Sheet):
        """Raises ImportError where ipympl or ipywidgets is missing."""
        import ipywidgets  # pyright: ignore[reportMissingImports]
        from ipympl.backend_nbagg import Canvas, FigureManager  # pyright: ignore[reportMissingImports]

        self.sheet = sheet
        self.canvas: Any = Canvas(sheet.figure)
        FigureManager(self.canvas, 0)
        self.canvas.header_visible = False
        self.turning = Turning(sheet)
        self.slider = ipywidgets.IntSlider(0, 0, N_STEPS, description="time", readout=False, layout={"width": "60%"})
        self.slider.observe(lambda change: self.show(change["new"]), names="value")
        player = ipywidgets.Play(value=0, min=0, max=N_STEPS, interval=FRAME)
        ipywidgets.jslink((player, "value"), (self.slider, "value"))
        self.seconds = ipywidgets.Label()
        below = [ipywidgets.HBox([player, self.slider, self.seconds])] if len(sheet.mechanism.ts) > 1 else []
        self.widget = ipywidgets.VBox([self.canvas, *below])
        self.show(0)

    def show(self, step: int) -> None:
        """Move the drawing to a step of the slider."""
        first, last = self.sheet.mechanism.ts[[0, -1]]
        t = float(first + (last - first) * step / N_STEPS)
        self.seconds.value = f"{t:.4f} s of {last:.4g} s"
        self.sheet.update(self.sheet.mechanism.pose(t))
        self.canvas.draw_idle()

    def _repr_mimebundle_(self, **options):
        """What a notebook shows."""
        return self.widget._repr_mimebundle_(**options)
