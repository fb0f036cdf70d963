"""The figure of a comparison of models."""

from typing import TYPE_CHECKING

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.studies.fit.figures import components_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_of(comparison, title: str = "") -> "Figure":
    """Errors over the noise, criteria, and the predictions of all models beside the record.

    Raises:
        SceneError: where no candidate ran.
    """
    from spherejax.output.plot.model_choice import ComparedModel, model_choice_figure

    if comparison.best is None:
        raise SceneError(f"there is nothing to draw: {comparison.verdict}")
    models, components = [], {}
    for name, one in comparison.evidence.items():
        if one.diagnosis:
            continue
        fit = comparison.every_fit[name]
        components[name] = components_of(fit.problem, fit.tables, fit.noise)
        numbers = one.residuals, one.prediction, one.criterion, one.criterion_error
        models.append(ComparedModel(name, name == comparison.best, *numbers))
    shown = int(np.argmax([float(np.ptp(part.measured)) > 0 for part in components[comparison.best]]))
    predictions = {name: parts[shown].predicted for name, parts in components.items()}
    record = components[comparison.best][shown]
    return model_choice_figure(models, record, predictions, title or "Comparison of models")
