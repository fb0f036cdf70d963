"""The rig's answer as a dataset, as a table, as a file of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.output.tables import write_rows
from spherejax.studies.rig.bench import LOADS
from spherejax.studies.rig.characteristics import GIVES
from spherejax.studies.rig.shown import SHOWN, RigStatus, ShownCharacteristic, compliance_shown

if TYPE_CHECKING:
    import xarray

IN_TABLE = (
    "toe",
    "camber",
    "caster",
    "kingpin_inclination",
    "scrub_radius",
    "caster_trail",
    "track_change",
    "recession",
    "roll_center_height",
    "braking_angle",
    "wheel_load",
    "wheel_rate",
    "motion_ratio",
    "toe_gradient",
)
"""Characteristics of the table that is printed; a file of it has all."""

LOAD_UNITS = {"longitudinal": "N", "lateral": "N", "aligning": "N m", "driving": "N"}


def dataset_of(rig: Any) -> "xarray.Dataset":
    """Curves in SI units; the dimension is what varies alone, else the position."""
    import xarray

    axis = _axis(rig)
    inputs = {
        "travel": (rig.travel, "m", "travel of the contact patch"),
        "steer": (rig.steer, "m", "displacement of the steering (rad where it is an angle)"),
        **{f"load_{n}": (rig.loads[:, i], LOAD_UNITS[n], f"{n} load") for i, n in enumerate(LOADS)},
    }
    coords = {
        name: (axis, np.asarray(values), {"units": unit, "long_name": label})
        for name, (values, unit, label) in inputs.items()
    }
    data: dict[str, Any] = {
        name: (axis, np.asarray(values), {"units": SHOWN[name].si, "long_name": SHOWN[name].label})
        for name, values in rig.curves.items()
    }
    words = "change of toe, camber [rad], of the tread's point on the road in x and y [m] by a load [N or N m]"
    data["compliance"] = ((axis, "gives", "load"), np.asarray(rig.compliance), {"long_name": words})
    meanings = ", ".join(f"{int(kind)}: {kind.name}" for kind in RigStatus)
    data["status"] = (axis, np.asarray(rig.status), {"long_name": meanings})
    coords |= {"gives": ("gives", list(GIVES)), "load": ("load", list(LOADS))}
    return xarray.Dataset(data, coords, {"axes": "ISO 8855: x forward, y to the left, z up", "side": int(rig.side)})


def _axis(rig: Any) -> str:
    varies = [name for name in ("travel", "steer") if np.ptp(np.asarray(getattr(rig, name))) > 0]
    varied = np.asarray(getattr(rig, varies[0])) if len(varies) == 1 else np.zeros(0)
    is_alone = len(np.unique(varied)) == len(varied) > 0
    return varies[0] if is_alone else "position"


def table_of(rig: Any) -> str:
    """The table that is printed: positions as columns, at most nine of them."""
    n = len(np.asarray(rig.travel))
    at = np.unique(np.linspace(0, n - 1, min(n, 9)).round().astype(int))
    rows = [("travel", "mm", 1e3 * np.asarray(rig.travel)[at])]
    if np.any(np.asarray(rig.steer) != 0):
        rows.append(("steer", "mm", 1e3 * np.asarray(rig.steer)[at]))
    for i, name in enumerate(LOADS):
        if np.any(np.asarray(rig.loads)[:, i] != 0):
            rows.append((f"{name} load", LOAD_UNITS[name], np.asarray(rig.loads)[at, i]))
    shown = [(SHOWN[name], np.asarray(rig.curves[name])[at]) for name in IN_TABLE if name in rig.curves]
    compliance = np.asarray(rig.compliance)
    if np.any(np.nan_to_num(compliance) != 0):
        shown += [
            (compliance_shown(g, load), compliance[at, i, j])
            for i, g in enumerate(GIVES)
            for j, load in enumerate(LOADS)
        ]
    rows += [(each.label, each.unit, each.factor * values) for each, values in shown]
    cells = [(label, f"[{unit}]", *(_cell(x) for x in values)) for label, unit, values in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), row[1].ljust(widths[1]), *map(str.rjust, row[2:], widths[2:])]).rstrip()
        for row in cells
    ]
    side = "left" if float(rig.side) > 0 else "right"
    n_missing = int(np.sum(np.asarray(rig.status) != RigStatus.FOUND))
    missing = f"; {n_missing} have no result" if n_missing else ""
    return "\n".join([f"Suspension rig, {side} corner, {n} positions{missing}:", *lines])


def _cell(x: float) -> str:
    """Four digits; what is below a millionth of a shown unit is rounding."""
    return "0" if abs(x) < 1e-6 else f"{x:.4g}"


def write_csv(rig: Any, path: Any) -> None:
    """All positions, with shown units in the head."""
    columns: list[tuple[str, Any]] = [
        ("travel [mm]", 1e3 * np.asarray(rig.travel)),
        ("steer [mm]", 1e3 * np.asarray(rig.steer)),
        *((f"{name} load [{LOAD_UNITS[name]}]", np.asarray(rig.loads)[:, i]) for i, name in enumerate(LOADS)),
    ]
    columns += [_column(name, SHOWN[name], values) for name, values in rig.curves.items()]
    compliance = np.asarray(rig.compliance)
    columns += [
        _column(f"{g}_by_{load}", compliance_shown(g, load), compliance[:, i, j])
        for i, g in enumerate(GIVES)
        for j, load in enumerate(LOADS)
    ]
    columns.append(("status", [RigStatus(int(each)).name for each in np.asarray(rig.status)]))
    write_rows(Path(path), [name for name, _ in columns], zip(*(values for _, values in columns), strict=True))


def _column(name: str, shown: ShownCharacteristic, values: Any) -> tuple[str, Any]:
    return f"{name} [{shown.unit}]", shown.factor * np.asarray(values)
