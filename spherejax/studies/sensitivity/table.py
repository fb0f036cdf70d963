"""Sensitivities as a data set, as text and as pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.motion.dataset import AXES, COMPONENTS

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from spherejax.studies.sensitivity.result import Column, Sensitivities

OWN_DIMS: dict[int, tuple[str, tuple[str, ...]]] = {3: ("axis", AXES), 4: ("component", COMPONENTS)}
SHOWN = 12
"""Lines of the ranking that are printed."""


def dataset_of(found: "Sensitivities") -> "xarray.Dataset":
    """The data set; see `Sensitivities.to_xarray`."""
    import xarray

    variables, coordinates = {}, {}
    for column in found.columns:
        own, coordinate = _own_dims(column)
        coordinates.update(coordinate)
        shape = (len(found.ts), *([len(column.labels)] if own else []))
        unit, n = column.unit, len(found.names)
        slopes = column.slopes.reshape(*shape, n)
        per = f"{unit} per unit of the parameter" if unit else "per unit of the parameter"
        variables[column.name] = (("time", *own), column.values.reshape(shape), {"units": unit})
        variables[f"sensitivity.{column.name}"] = (
            ("time", *own, "parameter"), slopes, {"units": per, "long_name": f"d {column.name} / d parameter"}
        )  # fmt: skip
        variables[f"normalized.{column.name}"] = (
            ("time", *own, "parameter"), slopes * found.sizes,
            {"units": unit, "long_name": f"|parameter| d {column.name} / d parameter"}
        )  # fmt: skip
    coordinates = {
        "time": ("time", found.ts, {"units": "s", "long_name": "time"}),
        "parameter": found.names,
        "value": ("parameter", np.array(list(found.parameters.values())), {"long_name": "value of the parameter"}),
        **coordinates,
    }
    facts = {
        "mode": found.mode,
        "reason": found.reason,
        "method": found.method,
        "n_steps": found.n_steps,
        "seconds": found.seconds,
    }
    return xarray.Dataset(variables, coordinates, {**facts, "diagnosis": found.diagnosis or "none"})


def _own_dims(column: "Column") -> tuple[tuple[str, ...], dict[str, list[str]]]:
    n = len(column.labels)
    if n == 1:
        return (), {}
    name, labels = OWN_DIMS.get(n, (f"{column.name}_0", tuple(map(str, range(n)))))
    return (name,), {name: list(labels)}


def text_of(found: "Sensitivities") -> str:
    """The text; see `Sensitivities.__str__`."""
    lines = [
        f"Sensitivities of {', '.join(column.name for column in found.columns)} by {len(found.names)} parameters, "
        f"in {found.mode} mode:",
        f"{found.reason}.",
        f"Integrated with {found.method}.",
    ]
    if found.diagnosis:
        lines.append(f"The run failed: {found.diagnosis}")
    ranking = found.ranking
    rows = [("parameter", "observable", "effect of 1 %", "of its variation", "largest at")]
    for each in ranking[:SHOWN]:
        unit = found.column(each.observable).unit
        effect, share = f"{each.effect:.3g} {unit}".strip(), f"{100 * each.share:.3g} %"
        rows.append((each.parameter, each.observable, effect, share, f"{each.t_largest:.4g} s"))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    if len(ranking) > SHOWN:
        lines.append(f"... and {len(ranking) - SHOWN} more, in .ranking")
    if np.any(np.array(list(found.parameters.values())) == 0):
        lines.append("For a parameter that is 0 the effect is that of a change by 0.01 of its unit.")
    return "\n".join(lines)


def figures_of(found: "Sensitivities") -> "dict[str, Figure]":
    """The figures; see `Sensitivities.figures`."""
    from spherejax.output.plot.sensitivities import Effects, effects_figure, ranking_figure

    figures: dict[str, Any] = {}
    order = [each for each in dict.fromkeys(influence.parameter for influence in found.ranking)]
    for column in found.columns:
        if len(found.ts) > 1:
            chosen = [found.names.index(name) for name in order]
            effects = 0.01 * column.slopes[:, :, chosen] * found.sizes[chosen]
            figures[column.name] = effects_figure(
                Effects(column.name, column.unit, found.ts, tuple(order), column.labels, effects)
            )
    figures["ranking"] = ranking_figure([(i.parameter, i.observable, i.share) for i in found.ranking])
    return figures
