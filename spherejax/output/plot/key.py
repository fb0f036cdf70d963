"""The key of a drawing: which symbol is which kind of joint."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import ScaledTranslation

from spherejax.output.plot.camera import camera_from
from spherejax.output.plot.mechanism import DrawnJoint, Mechanism
from spherejax.output.plot.space import colors_of, patch_of
from spherejax.output.plot.strokes import Stroke
from spherejax.output.plot.symbols import symbol_strokes

HEIGHT = 0.26
"""Height of the row [inch]."""

LEAD_COLOR, LEAD_DASHES = "0.6", (0, (4, 3))
"""Of the line from a joint to the panel that magnifies it."""

_SIZE, _GAP = 0.065, 0.22
"""Radius of a symbol, and room between entries [inch]."""


def draw_key(ax: Axes, mechanism: Mechanism, *, bodies: bool, magnified: bool = False) -> None:
    """Rows with the symbol and the name of each kind of joint, in a panel of their own.

    Args:
        ax: the panel, whose layout is final.
        mechanism: what is drawn.
        bodies: whether bodies are named too, where nothing else names them.
        magnified: whether a dashed line leads from a joint to a panel that magnifies it.
    """
    ax.set_axis_off()
    camera = camera_from(-50.0, 22.0, np.zeros(3))
    entries = {}
    if bodies:
        bar = _SIZE * np.array([[-1.6, 0.0], [1.6, 0.0]])
        entries = {name: [Stroke(bar, edge=color, width=4.0)] for name, color in colors_of(mechanism).items()}
    for name, joint in kinds_of(mechanism).items():
        apart = camera.right * _SIZE * (1.8 if joint.kind.startswith(("Distance", "PointOnCircle")) else 0.0)
        ends = [-apart, apart]
        axes = [np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])][: max(1, len(joint.axes))]
        if joint.kind in ("PointOnPlane", "ParallelAxes"):
            axes = [np.array([0.0, 0.0, 1.0])] * len(axes)
        entries[name] = symbol_strokes(joint, ends, axes, camera, _SIZE)
    if magnified:
        lead = _SIZE * np.array([[-2.4, 0.0], [2.4, 0.0]])
        entries["from a joint to its magnification"] = [Stroke(lead, edge=LEAD_COLOR, width=0.7, dashes=LEAD_DASHES)]
    _write(ax, entries)


def _write(ax: Axes, entries: Mapping[str, Sequence[Stroke]]) -> None:
    """Entry after entry from left to right; in a new row where the panel ends."""
    figure: Any = ax.figure
    corner: Any = ax.transAxes
    origin = figure.dpi_scale_trans + ScaledTranslation(0, 0, corner)
    width = ax.get_position(original=True).width * figure.bbox.width / figure.dpi
    x, y = _GAP, HEIGHT / 2
    for name, strokes in entries.items():
        text = ax.text(0, 0, name, fontsize=7.5, va="center", color="0.25", gid="key")
        reach = max(float(np.nanmax(np.abs(stroke.points[:, 0]))) for stroke in strokes)
        length = 2 * reach + 0.05 + text.get_window_extent().width / figure.dpi
        if x + length > width and x > _GAP:
            x, y = _GAP, y - HEIGHT
        for stroke in strokes:
            artist: PathPatch = patch_of(stroke)
            artist.set_path(Path(stroke.points + np.array([x + reach, y])))
            artist.set_transform(origin)
            artist.set_clip_on(False)
            ax.add_artist(artist)
        text.set_transform(origin)
        text.set_position((x + 2 * reach + 0.05, y))
        x += length + _GAP


def kinds_of(mechanism: Mechanism) -> dict[str, DrawnJoint]:
    """One joint of each kind, by what the kind is called."""
    return {kind_name(joint): joint for joint in mechanism.joints.values()}


def kind_name(joint: DrawnJoint) -> str:
    """What a joint is called in the key, e.g. `spherical, dry with friction`."""
    kind = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joint.kind).lower()
    if joint.model is None or joint.model.is_ideal:
        return kind
    model = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(joint.model).__name__).lower()
    friction = " with friction" if getattr(joint.model, "friction", None) is not None and model == "dry" else ""
    return f"{kind}, {model}{friction}"
