"""Numbers of a result as people read them."""

import numpy as np


def percent_text(probability: float) -> str:
    """A probability for people: never 0 or 100 %, which no evidence gives."""
    if probability > 0.995:
        return "over 99 %"
    return "below 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def probability_text(probability: float | None) -> str:
    """A probability with its name; None: not known."""
    if probability is None:
        return "probability not known"
    return f"probability {percent_text(probability)}"


def short_text(array: np.ndarray) -> str:
    """A small array in one line, four digits behind the point."""
    text = np.array2string(array, formatter={"float_kind": lambda v: f"{round(v, 4) + 0.0:.4f}"})
    return " ".join(text.split())
