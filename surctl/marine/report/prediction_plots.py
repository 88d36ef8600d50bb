"""Plot of a predicted motion beside the measured one, and beside the prediction that holds the last velocity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.marine.vehicle import LOG_MOTION, Prediction
from surctl.report.pictures import save_figure
from surctl.report.theme import AVOIDING, INK, MUTED, ROBOT, dress, head, new_figure

__all__ = ["plot_prediction", "save_prediction"]

_LABELS = dict(
    zip(LOG_MOTION, ("x [m]", "y [m]", "z [m]", "ψ [rad]", "u [m/s]", "v [m/s]", "w [m/s]", "r [rad/s]"), strict=True)
)
_MOST_ROWS = 6000  # rows of a log that a plot shows; more would merge


def plot_prediction(prediction: Prediction, *, title: str = "Prediction") -> Figure:
    """Plot each measured velocity, its prediction in every window, and the velocity held; poses if none is measured.

    Args:
        prediction: the result of `surctl.marine.vehicle.predict` or `held_out`.
        title: title of the figure.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.report import plot_prediction
        >>> from surctl.marine.vehicle import MotionLog, load_vehicle, predict
        >>> motion = np.full((200, 8), np.nan)
        >>> motion[:, 4] = 0.3
        >>> log = MotionLog(0.1 * np.arange(200), motion, np.full((200, 4), 0.1))
        >>> [ax.get_ylabel() for ax in plot_prediction(predict(log, load_vehicle("sur400"))).axes]
        ['u [m/s]']
    """
    columns = [c for c in LOG_MOTION[4:] if c in prediction.model] or [c for c in LOG_MOTION if c in prediction.model]
    figure = new_figure(9.8, 1.0 + 1.9 * len(columns))
    head(figure, f"{title}: {prediction.windows} windows of {prediction.window:g} s")
    axes = figure.subplots(len(columns), 1, sharex=True, squeeze=False).ravel()
    rows = slice(0, _MOST_ROWS)
    time = _broken(prediction.time, prediction.starts)[rows]
    for ax, column in zip(axes, columns, strict=True):
        k = LOG_MOTION.index(column)
        ax.plot(prediction.time[rows], prediction.measured[rows, k], ".", ms=2.0, color=MUTED, label="measured")
        held = _broken(prediction.held[:, k], prediction.starts)[rows]
        predicted = _broken(prediction.predicted[:, k], prediction.starts)[rows]
        ax.plot(time, held, "--", lw=1.1, color=AVOIDING, label="last velocity held")
        ax.plot(time, predicted, lw=1.4, color=ROBOT, label="model")
        text = f"RMS error: model {prediction.model[column]:.3g}, last velocity held {prediction.hold[column]:.3g}"
        dress(ax, title=text, y=_LABELS[column])
    axes[-1].set_xlabel("time [s]", fontsize=9.5, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.5, frameon=False)
    return figure


def save_prediction(prediction: Prediction, path: Path | str, *, title: str = "Prediction") -> Path:
    """Write the plot of a prediction as a PNG; return its path.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.report import save_prediction
        >>> from surctl.marine.vehicle import MotionLog, load_vehicle, predict
        >>> motion = np.full((200, 8), np.nan)
        >>> motion[:, 4] = 0.3
        >>> log = MotionLog(0.1 * np.arange(200), motion, np.full((200, 4), 0.1))
        >>> print(save_prediction(predict(log, load_vehicle("sur400")), "held-out.png"))
        held-out.png
    """
    path = Path(path)
    return save_figure(plot_prediction(prediction, title=title), path.parent, (path.stem,))


def _broken(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    # NaN before each window, so that no line joins two windows
    return np.insert(values, starts[1:], np.nan)
