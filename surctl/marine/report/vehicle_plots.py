"""Plots of a vehicle: predictions of an identified model against a log, and the forces that the thrusters reach."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.allocation import working_flags
from surctl.marine.vehicle import LOG_MOTION, Actuators, Prediction, Vehicle, attainable
from surctl.marine.vehicle.linearise import command_range
from surctl.report.theme import AVOIDING, CYCLE, INK, MUTED, ROBOT, dress, head, legend_below, new_axes, new_figure

_LABELS = dict(
    zip(LOG_MOTION, ("x [m]", "y [m]", "z [m]", "ψ [rad]", "u [m/s]", "v [m/s]", "w [m/s]", "r [rad/s]"), strict=True)
)
_MOST_ROWS = 6000  # rows of a log that a plot shows; more would merge


def plot_prediction(prediction: Prediction, *, title: str = "Prediction") -> Figure:
    """Plot each measured velocity, its prediction in every window, and the velocity held; poses if none is measured.

    Args:
        prediction: the result of `surctl.marine.vehicle.predict` or one of `held_out_windows`.
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
        unit, rest = _LABELS[column].split()[1].strip("[]"), f"last velocity held {prediction.hold[column]:.3g}"
        text = f"RMS error: model {prediction.model[column]:.3g} {unit}, {rest} {unit}"
        dress(ax, title=text, y=_LABELS[column])
    axes[-1].set_xlabel("time [s]", fontsize=9.5, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8.5, frameon=False)
    return figure


def _broken(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    # NaN before each window, so that no line joins two windows
    return np.insert(values, starts[1:], np.nan)


_SHARES = (0.0, 0.4, 0.8)  # yaw moments as shares of the largest one


def plot_attainable(vehicle: Vehicle, ax: Axes | None = None, *, failed: Sequence[str] = ()) -> Axes:
    """Plot the attainable surge and sway forces at several yaw moments, without heave, and the box of Fu_max, Fv_max.

    For a craft without sway force, plot the surge forces and yaw moments instead, with the box of Fu_max and Fr_max;
    if it has fins, at the speed at which its limits hold and at half of this speed.

    Args:
        vehicle: a vehicle with thrusters.
        ax: axes to plot into; None: axes of a new figure.
        failed: names of thrusters that give no force.

    Raises:
        InputError: the vehicle file describes no thrusters, or a name is unknown.

    Example:
        >>> from surctl.marine.report import plot_attainable
        >>> from surctl.marine.vehicle import load_vehicle
        >>> ax = plot_attainable(load_vehicle("bluerov2-heavy"))
        >>> ax.get_xlabel(), [text.get_text() for text in ax.get_legend().get_texts()][0]
        ('surge force F_u [N]', 'yaw moment 0 N m')
    """
    actuators, sways = _thrusters_of(vehicle), vehicle["Fv_max"] > 0
    outlines = (_at_yaw_moments if sways else _at_speeds)(vehicle, actuators, failed)
    lost = f", without {', '.join(failed)}" if failed else ""
    up, limits = ("sway force F_v [N]", "Fu_max, Fv_max") if sways else ("yaw moment F_r [N m]", "Fu_max, Fr_max")
    title = f"{vehicle.name}: attainable forces{lost}"
    ax = dress(ax or new_axes(5.4, 5.8), title=title, x="surge force F_u [N]", y=up)
    for k, (label, corners) in enumerate(outlines.items()):
        if len(corners):
            ax.fill(*corners.T, color=CYCLE[k], alpha=0.10)
            ax.plot(*np.vstack([corners, corners[:1]]).T, color=CYCLE[k], linewidth=1.6, label=label)
    most = vehicle.thrust_limit[:2]
    low, high = (-most, most) if sways else command_range(vehicle)[:, [0, 3]]
    ax.add_patch(Rectangle(tuple(low), *(high - low), fill=False, edgecolor=INK, linestyle="--", label=limits))
    if sways:
        ax.set_aspect("equal", adjustable="datalim")
    ax.autoscale_view()
    legend_below(ax, columns=2, handles=ax.get_legend_handles_labels()[0])
    return ax


def _at_yaw_moments(vehicle: Vehicle, actuators: Actuators, failed: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return the corners (n, 2) of the attainable surge and sway forces [N] at several yaw moments, by label."""
    working, forces = working_flags(actuators, failed), attainable(actuators)
    largest = float(np.abs(forces.intervals(working=working)[3]).min())
    moments = (share * largest for share in _SHARES)
    return {f"yaw moment {yaw:.3g} N m": forces.planar(yaw=yaw, working=working) for yaw in moments}


def _at_speeds(vehicle: Vehicle, actuators: Actuators, failed: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return the corners (n, 2) of the attainable surge forces [N] and yaw moments [N m] at some speeds, by label."""
    forces, speeds = attainable(actuators, (0, 3)), (vehicle.speed, vehicle.speed / 2)
    return {
        f"at {speed:.3g} m/s" if actuators.fins else "at any speed": forces.outline(
            working=working_flags(actuators, failed, speed=speed)
        )
        for speed in speeds[: 2 if actuators.fins else 1]
    }


def _thrusters_of(vehicle: Vehicle) -> Actuators:
    """Return the thrusters of a vehicle; InputError if its file describes none."""
    if vehicle.actuators is None:
        remedy = "add [[thruster]] tables, as in surctl list --show bluerov2-heavy"
        raise InputError("describes no thrusters", key="vehicle", value=vehicle.name, remedy=remedy)
    return vehicle.actuators
