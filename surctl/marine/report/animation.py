"""Animations of a run: path, hull, heading, obstacles, sonar beams and clearance."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

from surctl.errors import InputError
from surctl.files import write_file
from surctl.marine.report.beams import INSTANT, beam_patch, beams_at
from surctl.marine.report.plan_view import body_outline, describe, draw_ends, draw_site
from surctl.marine.simulation import Run
from surctl.report.mp4 import check_mp4, mp4
from surctl.report.numbers import number
from surctl.report.theme import BAD, GOOD, INK, MUTED, OBSTACLE, ROBOT, dress, finite, new_figure

__all__ = ["RATE", "check_animation", "frame_steps", "frames", "save_animation"]

RATE = 10
"""Frames per second of an animation."""
_SUFFIXES = (".gif", ".mp4")
_SPEEDS = (1, 2, 5, 10, 20, 50, 100)  # playback speeds as multiples of real time
_MOST = 150  # approximate largest number of frames: 15 s of animation
_COLOURS = 128  # size of the palette that all frames of a GIF share


def check_animation(path: Path | str, *, key: str = "--animate") -> Path:
    """Return the path if an animation can be written to it; `key` is the option that names it.

    Raises:
        InputError: the name does not end in .gif or .mp4, or the path is a folder.
        ToolMissing: the name ends in .mp4, and neither ffmpeg nor PyAV is installed.

    Example:
        >>> from surctl.marine.report import check_animation
        >>> check_animation("run.avi")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: --animate = 'run.avi': is not the name of an animation; end the name in .gif or .mp4
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        remedy = "end the name in .gif or .mp4"
        raise InputError("is not the name of an animation", key=key, value=str(path), remedy=remedy)
    if path.is_dir():
        raise InputError("is a folder", key=key, value=str(path), remedy="name a file")
    if path.suffix.lower() == ".mp4":
        check_mp4(path, key=key)
    return path


def frame_steps(run: Run, *, apart: float) -> list[int]:
    """Return indices of control periods with intervals of `apart` [s] or slightly more, including first and last."""
    last = len(run.record.time) - 1
    step = max(1, int(np.ceil(apart / run.law.dt - 1e-9)))
    return [*range(0, last, step), last]


def playback_speed(run: Run) -> int:
    """Return how much faster than real time an animation of the run plays."""
    duration = float(run.record.time[-1])
    return next((s for s in _SPEEDS if duration * RATE / s <= _MOST), _SPEEDS[-1])


def save_animation(run: Run, path: Path | str) -> Path:
    """Write a run as a GIF, or as an MP4, according to the suffix of the path; return the path.

    The animation plays at `RATE` frames per second. A long run plays faster than real time, and the animation shows
    the factor. Equal runs give GIF files with equal bytes.

    Raises:
        InputError: see `check_animation`; or the file cannot be written.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import save_animation
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, gains = replace(load_scenario("pool-behind"), time_limit=1.0), load_gains("default")
        >>> run = simulate(mission, load_vehicle("sur400"), gains=gains, law=build_law("closed_form"))
        >>> path = save_animation(run, "run.gif")
        >>> path.name, path.read_bytes()[:6]
        ('run.gif', b'GIF89a')
    """
    path = check_animation(path)
    pictures = frames(run)
    return write_file(
        path, _gif(pictures) if path.suffix.lower() == ".gif" else mp4(pictures, rate=RATE, key="--animate")
    )


def frames(run: Run) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (height, width, 3) in order; height and width are even, as video encoders require."""
    speed = playback_speed(run)
    length, width, _ = run.scenario.site
    figure = new_figure(7.2, float(np.clip(6.6 * width / length + 2.9, 4.4, 8.4)))
    figure.set_dpi(100)
    plan, strip = figure.subplots(2, 1, height_ratios=[figure.get_figheight() - 2.3, 1.0])
    _draw_plan(plan, run)
    _draw_strip(strip, run)
    figure.legend(handles=_handles(run), loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    heading = strip.set_title(" ", loc="left", fontsize=9.5, color=INK, parse_math=False)
    canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
    canvas.draw()
    figure.set_layout_engine("none")  # later frames reuse this background, so the layout must not change
    ground = canvas.copy_from_bbox(figure.bbox)
    for step in frame_steps(run, apart=speed / RATE):
        canvas.restore_region(ground)
        for ax, artist in _moving(run, step, plan, strip, heading, speed):
            ax.draw_artist(artist)
            if artist is not heading:
                artist.remove()
        picture = np.array(canvas.buffer_rgba())[..., :3]
        yield picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]


def _draw_plan(ax: Axes, run: Run) -> None:
    length, width, _ = run.scenario.site
    dress(ax, title=describe(run), x="x in {E} [m]", y="y in {E} [m]")
    draw_site(ax, length, width)
    points, track = run.scenario.path.waypoints, run.record.eta[:, :2]
    ax.plot(points[:, 0], points[:, 1], color=INK, linestyle="--", linewidth=1.1, zorder=3)
    ax.plot(track[:, 0], track[:, 1], color=ROBOT, linewidth=0.8, alpha=0.35, zorder=3)
    draw_ends(ax, run)
    rim = 0.03 * max(length, width)
    ax.set(aspect="equal", xlim=(-rim, length + rim), ylim=(-rim, width + rim))


def _draw_strip(ax: Axes, run: Run) -> None:
    # background of every frame; each frame adds a time cursor
    dress(ax, x="time [s]", y="clearance [m]")
    time = run.record.time
    ax.plot(time, finite(run.record.clearance), color=ROBOT, linewidth=1.2)
    ax.axhline(0.0, color=BAD, linewidth=1.4)
    ax.axhline(run.gains["margin"], color=MUTED, linewidth=1.0, linestyle="--")
    ax.set_xlim(0.0, max(float(time[-1]), run.law.dt))


def _moving(run: Run, step: int, plan: Axes, strip: Axes, heading: Text, speed: int) -> Iterator[tuple[Axes, Artist]]:
    # lowest first
    record, radius = run.record, run.vehicle["radius"]
    length, width, _ = run.scenario.site
    water = Rectangle((0, 0), length, width, transform=plan.transData)
    for beam in beams_at(run, step):
        yield plan, _clipped(plan, beam_patch(beam), water)
    for body in record.obstacles[step]:
        patch = body_outline(body.shape)
        patch.set(facecolor=OBSTACLE, edgecolor=INK, linewidth=0.8, alpha=0.85)
        yield plan, _clipped(plan, patch, None)
    (trail,) = plan.plot(*record.eta[: step + 1, :2].T, color=ROBOT, linewidth=2.0)
    yield plan, trail
    x, y, _, psi = record.eta[step]
    hull = Circle((x, y), radius, facecolor="white", edgecolor=ROBOT, linewidth=2.0)
    yield plan, _clipped(plan, hull, None)
    nose = np.array([[x, y], [x, y]]) + radius * np.array([[0.0], [1.0]]) * [np.cos(psi), np.sin(psi)]
    (line,) = plan.plot(*nose.T, color=ROBOT, linewidth=2.4)
    yield plan, line
    time, clearance = float(record.time[step]), float(record.clearance[step])
    (cursor,) = strip.plot([time], finite(np.array([clearance])), color=ROBOT, marker="o", markersize=7)
    yield strip, cursor
    fast = "" if speed == 1 else f"   ({speed} times real time)"
    heading.set_text(f"{time:.1f} s   clearance {number(clearance, digits=3)} m{fast}")
    heading.set_color(BAD if clearance <= 0 else INK)
    yield strip, heading


def _clipped(ax: Axes, patch: Patch, to: Rectangle | None) -> Patch:
    ax.add_patch(patch)
    if to is not None:
        patch.set_clip_path(to)
    return patch


def _handles(run: Run) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=INK, linestyle="--", linewidth=1.1, label="path"),
        Line2D([], [], color=ROBOT, linewidth=2.0, label="trajectory"),
        Line2D([], [], color=ROBOT, marker="o", markerfacecolor="white", linestyle="none", label="hull"),
        Line2D([], [], color=GOOD, marker="*", markersize=11, linestyle="none", label="target"),
        Patch(facecolor=OBSTACLE, edgecolor=INK, alpha=0.85, label="obstacle"),
    ]
    if run.sensing == "sonar":
        handles.append(Patch(facecolor=INSTANT, alpha=0.35, label="sonar beam with echo"))
    return handles


def _gif(pictures: Iterator[NDArray[np.uint8]]) -> bytes:
    # every frame uses the palette of the first frame, which contains every colour
    begun = next(pictures)
    nearest, colours = _palette(begun)
    first, *rest = (_indexed(nearest[_cells(p)], colours) for p in chain([begun], pictures))
    out = BytesIO()
    duration = [1000 // RATE] * len(rest) + [2000]  # the last frame stays for 2 s
    first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)
    return out.getvalue()


def _cells(picture: NDArray[np.uint8]) -> NDArray[np.int_]:
    # index of the colour among 32³ colours
    fine = picture.astype(int) >> 3
    cells: NDArray[np.int_] = (fine[..., 0] << 10) | (fine[..., 1] << 5) | fine[..., 2]
    return cells


def _palette(picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the k most frequent colours (k, 3) of a picture, and which of them is nearest to each of 32³ colours."""
    # Pillow's own mapping to a palette turns white into grey
    parts = np.stack(np.unravel_index(np.arange(1 << 15), (32, 32, 32)), axis=1)
    every = (parts << 3) | (parts >> 2)
    count = np.bincount(_cells(picture).ravel(), minlength=len(every))
    colours = every[np.argsort(-count, kind="stable")[: min(_COLOURS, np.count_nonzero(count))]]
    squares = (every**2).sum(axis=1)[:, None] - 2 * every @ colours.T + (colours**2).sum(axis=1)
    return squares.argmin(axis=1).astype(np.uint8), colours.astype(np.uint8)


def _indexed(indices: NDArray[np.uint8], colours: NDArray[np.uint8]) -> Image.Image:
    image = Image.fromarray(indices)
    image.putpalette(colours.tobytes())  # converts it to an image of palette indices
    return image
