"""Animations of a run (`--animate`, `--film`): GIF and MP4, speed of the film, and the player of the report."""

from __future__ import annotations

import importlib
import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO
from itertools import chain
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from surctl.errors import InputError, ToolMissing
from surctl.files import write_file
from surctl.marine.report.plan_view import (
    INSTANT,
    beam_patch,
    beams_at,
    body_middle,
    body_outline,
    box_corners,
    draw_ground,
)
from surctl.marine.simulation import Body, Run
from surctl.marine.world import Box
from surctl.report.document import Picture, Player
from surctl.report.theme import BAD, GOOD, INK, MUTED, OBSTACLE, ROBOT, dress, finite, new_figure, number

if TYPE_CHECKING:
    from surctl.marine.engine import EngineOptions, Moment

# Films as MP4, by the package PyAV


Frame = NDArray[np.uint8]


def _check_mp4(path: Path, *, key: str) -> None:
    """Raise ToolMissing if nothing here writes MP4; `key` is the option that names the file."""
    if find_spec("av") is None:
        remedy = "pip install 'surctl[film]', or end the name in .gif"
        raise ToolMissing("needs PyAV, which is not installed", key=key, value=str(path), remedy=remedy)


def mp4(pictures: Iterator[Frame], *, rate: int, key: str) -> bytes:
    """Return a film (H.264) of pictures (height, width, 3) whose sides are even, with `rate` pictures a second."""
    try:
        av: Any = importlib.import_module("av")
        with TemporaryDirectory() as folder:
            target, first = Path(folder) / "run.mp4", next(pictures)
            with av.open(str(target), "w", options={"movflags": "+faststart"}) as container:
                stream = container.add_stream("libx264", rate=rate)
                stream.height, stream.width, stream.pix_fmt = *first.shape[:2], "yuv420p"
                for picture in chain([first], pictures):
                    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
            return target.read_bytes()
    except InputError:  # of a picture
        raise
    except Exception as error:  # PyAV raises errors of many classes
        raise InputError(f"PyAV failed ({error})", key=key, remedy="end the name in .gif") from None


_RATE = 10
"""Frames per second of an animation."""
_SUFFIXES = (".gif", ".mp4")
_SPEEDS = (1, 2, 5, 10, 20, 50, 100)  # playback speeds as multiples of real time
_MOST = 150  # approximate largest number of frames: 15 s of animation


def check_animation(path: Path | str, *, key: str = "--animate") -> Path:
    """Return the path if an animation can be written to it; `key` is the option that names it.

    Raises:
        InputError: the name does not end in .gif or .mp4, or the path is a folder.
        ToolMissing: the name ends in .mp4, and PyAV is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        remedy = "end the name in .gif or .mp4"
        raise InputError("is not the name of an animation", key=key, value=str(path), remedy=remedy)
    if path.is_dir():
        raise InputError("is a folder", key=key, value=str(path), remedy="name a file")
    if path.suffix.lower() == ".mp4":
        _check_mp4(path, key=key)
    return path


def frame_steps(run: Run, *, apart: float) -> list[int]:
    """Return indices of control periods with intervals of `apart` [s] or slightly more, including first and last."""
    last = len(run.record.time) - 1
    step = max(1, int(np.ceil(apart / run.law.dt - 1e-9)))
    return [*range(0, last, step), last]


def _playback_speed(run: Run) -> int:
    """Return how much faster than real time an animation of the run plays."""
    duration = float(run.record.time[-1])
    return next((s for s in _SPEEDS if duration * _RATE / s <= _MOST), _SPEEDS[-1])


def save_animation(run: Run, path: Path | str) -> Path:
    """Write a run as a GIF, or as an MP4, according to the suffix of the path; return the path.

    The animation plays at `_RATE` frames per second. A long run plays faster than real time, and the animation shows
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
    return _written(frames(run), path, key="--animate")


def _written(pictures: Iterator[Frame], path: Path | str, *, key: str) -> Path:
    """Write pictures to an MP4 or a GIF; return the path."""
    path = check_animation(path, key=key)
    film = path.suffix.lower() == ".mp4"
    return write_file(path, mp4(pictures, rate=_RATE, key=key) if film else gif(list(pictures)))


def gif(pictures: Sequence[Frame]) -> bytes:
    """Return an animation of pictures (height, width, 3), whose last one stays for 2 s."""
    # one palette for all, from some of them; without dithering, which would flicker
    chosen = pictures[:: max(1, len(pictures) // 8)]
    sample = Image.fromarray(np.vstack([picture[::2, ::2] for picture in chosen]))
    palette = sample.quantize(256, method=Image.Quantize.FASTOCTREE)
    colours = np.asarray(sample).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    codes = (np.asarray(palette).astype(np.int64) << 24) + colours
    each, count = np.unique(codes, return_counts=True)
    each, table = each[np.argsort(count, kind="stable")], np.zeros((256, 3), np.uint8)
    # the most frequent colour of each entry: white stays white
    table[each >> 24] = each[:, None] >> np.array([16, 8, 0]) & 255
    palette.putpalette(table.tobytes())
    first, *rest = (Image.fromarray(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
    out, duration = BytesIO(), [1000 // _RATE] * len(rest) + [2000]
    first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)
    return out.getvalue()


def frames(run: Run) -> Iterator[Frame]:
    """Yield the frames (height, width, 3) in order; height and width are even, as video encoders require."""
    speed = _playback_speed(run)
    length, width, _ = run.scenario.site
    figure = new_figure(7.2, float(np.clip(6.6 * width / length + 2.9, 4.4, 8.4)))
    figure.set_dpi(100)
    plan, strip = figure.subplots(2, 1, height_ratios=[figure.get_figheight() - 2.3, 1.0])
    draw_ground(plan, run)
    plan.plot(*run.record.eta[:, :2].T, color=ROBOT, linewidth=0.8, alpha=0.35, zorder=3)
    _draw_strip(strip, run)
    figure.legend(handles=_handles(run), loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    heading = strip.set_title(" ", loc="left", fontsize=9.5, color=INK, parse_math=False)
    canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
    canvas.draw()
    figure.set_layout_engine("none")  # later frames reuse this background, so the layout must not change
    ground = canvas.copy_from_bbox(figure.bbox)
    for step in frame_steps(run, apart=speed / _RATE):
        canvas.restore_region(ground)
        for ax, artist in _moving(run, step, plan, strip, heading, speed):
            ax.draw_artist(artist)
            if artist is not heading:
                artist.remove()
        picture = np.array(canvas.buffer_rgba())[..., :3]
        yield picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]


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


_WIDTH = 640  # [pixels]
_PAGE_WIDTH, _PAGE_FRAMES = 480, 80  # of the film in a report, which has about 0.5 MB


def save_film(run: Run, path: Path | str, *, options: EngineOptions | None = None) -> Path:
    """Write a film of the run as a GIF, or as an MP4, by the suffix of the path; return the path.

    Raises:
        InputError: see `check_animation`; or the file cannot be written.
        ToolMissing: MuJoCo, or a library that renders without a screen, is not installed.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import save_film
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, gains = replace(load_scenario("pool-behind"), time_limit=0.2), load_gains("default")
        >>> run = simulate(mission, load_vehicle("sur400"), gains=gains, law=build_law("closed_form"))
        >>> save_film(run, "run.gif").read_bytes()[:6]
        b'GIF89a'
    """
    return _written(film_frames(run, options=options), path, key="--film")


def film_pictures(run: Run) -> tuple[list[int], tuple[str, ...]]:
    """Return the film of a report: the control steps that it shows, and for each a picture as a data URI (WebP).

    Raises:
        ToolMissing: MuJoCo, or a library that renders without a screen, is not installed.
    """
    apart = max(0.1, float(run.record.time[-1]) / _PAGE_FRAMES)
    pictures = []
    for frame in film_frames(run, apart=apart, width=_PAGE_WIDTH):
        out = BytesIO()
        Image.fromarray(frame).save(out, "WEBP", quality=60)
        pictures.append("data:image/webp;base64," + b64encode(out.getvalue()).decode())
    return frame_steps(run, apart=apart), tuple(pictures)


def film_frames(
    run: Run, *, options: EngineOptions | None = None, apart: float | None = None, width: int = _WIDTH
) -> Iterator[Frame]:
    """Yield the frames (height, width, 3) of the film in order: the view from above, below it those of side and nose.

    Args:
        run: the run.
        options: the options of MuJoCo.
        apart: time between two frames [s]; None: such that the film lasts at most about 15 s.
        width: width of the frames [pixels], a multiple of 32.
    """
    from surctl.marine.engine import Scene

    speed = _playback_speed(run) if apart is None else 1
    wide, small = ((side, side * 9 // 16) for side in (width, width // 2))
    with (
        Scene(run.scenario, run.vehicle, options=options, size=wide) as large,
        Scene(run.scenario, run.vehicle, options=options, size=small) as little,
    ):
        for step in frame_steps(run, apart=speed / _RATE if apart is None else apart):
            moment = moment_of(run, step)
            below = np.hstack([little.picture(camera, moment) for camera in ("side", "nose")])
            yield _labelled(np.vstack([large.picture("above", moment), below]), run, step, speed)


def moment_of(run: Run, step: int) -> Moment:
    """Return what a picture of a control step shows.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report.animation import moment_of
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains, law = load_gains("default"), build_law("closed_form")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> len(moment_of(run, 40).track)
        41
    """
    from surctl.marine.engine import Moment

    record = run.record
    tilt = (0.0, 0.0) if record.tilt is None else (float(record.tilt[step, 0]), float(record.tilt[step, 1]))
    beams = [(*b.apex, b.axis, b.half_angle, b.length, b.echo) for b in beams_at(run, step)]
    return Moment(record.eta[step], tilt, record.obstacles[step], record.eta[: step + 1, :3], beams)


def _labelled(picture: Frame, run: Run, step: int, speed: int) -> Frame:
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    fast = "" if speed == 1 else f"   {speed} x real time"
    time, clear = run.record.time[step], run.record.clearance[step]
    texts = {
        (8, 6): f"{run.scenario.name}   {run.plant}   {time:.1f} s   clearance {clear:.3f} m{fast}",
        (8, picture.shape[0] * 2 // 3 + 4): "from the side",
        (picture.shape[1] // 2 + 8, picture.shape[0] * 2 // 3 + 4): "from the nose",
    }
    for (x, y), text in texts.items():
        pen.text((x + 1, y + 1), text, fill=(0, 25, 35))
        pen.text((x, y), text, fill=(255, 255, 255))
    return np.array(image)


_APART = 0.1  # [s] smallest time between two frames
_LARGEST = 150_000  # [byte] largest size of the frames
_STILL = 5e-4  # [m] an obstacle that moves less has one position


def player(run: Run, still: Picture, *, film: bool = False) -> Player:
    """Return the run as a `Player` of the report; `still` is the picture shown on paper and without scripts.

    Args:
        run: the run.
        still: picture of the whole run.
        film: whether MuJoCo's pictures of the scene are shown beside the plan view.

    Raises:
        ToolMissing: `film`, but MuJoCo, or a library that renders without a screen, is not installed.
    """
    steps, pictures = film_pictures(run) if film else ([], ())
    apart, frames = _APART, player_frames(run, filmed=steps)
    while len(frames) > _LARGEST:
        apart *= 1.05 * len(frames) / _LARGEST
        frames = player_frames(run, apart=apart, filmed=steps)
    grid = _grid(run)
    words = f"Animation with a grid of {grid:g} m; below it, clearance over time. The arrow keys move the slider."
    if film:
        words += " Beside it, the scene from above, from the side and from the robot's nose (MuJoCo)."
    return Player(frames, replace(still, caption=f"{still.caption} {words}"), f"Animation. {still.alt}", pictures)


def _grid(run: Run) -> float:
    return 1.0 if max(run.scenario.site[:2]) <= 25 else 10.0


def player_frames(run: Run, *, apart: float = _APART, filmed: Sequence[int] = ()) -> str:
    """Return the frames, at least `apart` [s] from each other, as one JSON text without any `<`.

    `filmed` are the control steps of which the report has a picture of the scene.

    Lengths are in m, angles in rad, times in s, and positions in the world frame {E} unless stated otherwise; values
    that are not finite are null. The `length` of a beam is negative if the sonar reads its maximum range.
    """
    record, scenario, steps = run.record, run.scenario, frame_steps(run, apart=apart)
    frames = {
        "site": [float(side) for side in scenario.site[:2]],
        "grid": _grid(run),
        "radius": run.vehicle["radius"],
        "path": _rounded(scenario.path.waypoints, 3),
        "time": _rounded(record.time[steps], 2),
        "place": _rounded(record.eta[steps, :2], 3),
        "heading": _rounded(record.eta[steps, 3], 3),
        "speed": _rounded(np.hypot(record.nu[steps, 0], record.nu[steps, 1]), 3),
        "clearance": _rounded(record.clearance[steps], 3),
        "avoiding": [int(a) for a in run.telemetry("avoiding")[steps, 0] > 0.5],
        "closest": int(np.argmin(record.clearance[steps])),
        "obstacles": _obstacles([record.obstacles[k] for k in steps]),
        "beams": _beams(run, steps),
    }
    if filmed:
        frames["filmed"] = _rounded(record.time[list(filmed)], 2)
    # only a "<" could end the script element that contains the text
    return json.dumps(frames, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _obstacles(frames: Sequence[Sequence[Body]]) -> list[dict[str, object]]:
    # one centre per frame, or a single centre if the obstacle is fixed
    entries: list[dict[str, object]] = []
    for name in dict.fromkeys(body.name for bodies in frames for body in bodies):
        history = [next((body for body in bodies if body.name == name), None) for bodies in frames]
        first = next(body for body in history if body is not None)
        outline: dict[str, object]
        if isinstance(first.shape, Box):
            outline = {"corners": _rounded(box_corners(first.shape), 3)}
        else:
            outline = {"radius": float(getattr(first.shape, "radius", 0.0))}
        places = [None if body is None else _rounded(body_middle(body), 3) for body in history]
        middles = np.array([body_middle(body) for body in history if body is not None])
        still = len(middles) == len(history) and float(np.ptp(middles, axis=0).max()) < _STILL
        entries.append({"name": name, **outline, "at": places[:1] if still else places})
    return entries


def _beams(run: Run, steps: Sequence[int]) -> list[dict[str, object]]:
    # apex and axis in {B}; a negative length means no echo
    if run.sensing != "sonar":
        return []
    array, ranges = run.scenario.sensors.array_on(run.vehicle["radius"]), run.telemetry("ranges")[steps]
    signed = np.where(ranges < array.maximum - array.resolution, ranges, -ranges)
    entries: list[dict[str, object]] = []
    for sensor in range(array.size):
        x, y, axis = array.apex(sensor, position=np.zeros(2), heading=0.0)
        where = {"apex": _rounded(np.array([x, y]), 3), "axis": round(axis, 4), "half": round(array.half_angle, 4)}
        entries.append({**where, "length": _rounded(signed[:, sensor], 2)})
    return entries


def _rounded(values: NDArray[np.float64], digits: int) -> list[object]:
    def rounded(value: object) -> object:
        if isinstance(value, list):
            return [rounded(one) for one in value]
        return round(float(value), digits) if isinstance(value, float) and isfinite(value) else None

    return [rounded(value) for value in np.asarray(values, dtype=float).tolist()]
