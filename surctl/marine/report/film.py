"""A film of a run in MuJoCo's scene: from above, from the side and from the robot's nose."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from surctl.files import write_file
from surctl.marine.report.animation import RATE, check_animation, frame_steps, playback_speed
from surctl.marine.report.beams import beams_at
from surctl.marine.simulation import Run
from surctl.report.mp4 import mp4

if TYPE_CHECKING:
    from surctl.marine.engine import EngineOptions, Moment

__all__ = ["check_film", "film_frames", "film_pictures", "moment_of", "save_film"]

Picture = NDArray[np.uint8]

_WIDTH = 640  # [pixels]
_PAGE_WIDTH, _PAGE_FRAMES = 480, 80  # of the film in a report, which has about 0.5 MB


def check_film(path: Path | str) -> Path:
    """Return the path if a film can be written to it; raise as `check_animation` otherwise.

    Example:
        >>> from surctl.marine.report import check_film
        >>> check_film("run.avi")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: --film = 'run.avi': is not the name of an animation; end the name in .gif or .mp4
    """
    return check_animation(path, key="--film")


def save_film(run: Run, path: Path | str, *, options: EngineOptions | None = None) -> Path:
    """Write a film of the run as a GIF, or as an MP4, by the suffix of the path; return the path.

    Raises:
        InputError: see `check_film`; or the file cannot be written.
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
    path = check_film(path)
    frames = film_frames(run, options=options)
    gif = path.suffix.lower() == ".gif"
    return write_file(path, _gif(list(frames)) if gif else mp4(frames, rate=RATE, key="--film"))


def film_pictures(run: Run) -> tuple[list[int], tuple[str, ...]]:
    """Return the film of a report: the control steps that it shows, and for each a picture as a data URI (WebP).

    Raises:
        ToolMissing: MuJoCo, or a library that renders without a screen, is not installed.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import film_pictures
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, gains = replace(load_scenario("pool-behind"), time_limit=0.2), load_gains("default")
        >>> run = simulate(mission, load_vehicle("sur400"), gains=gains, law=build_law("closed_form"))
        >>> steps, pictures = film_pictures(run)
        >>> steps, pictures[0][:23]
        ([0, 2, 3], 'data:image/webp;base64,')
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
) -> Iterator[Picture]:
    """Yield the frames (height, width, 3) of the film in order: the view from above, below it those of side and nose.

    Args:
        run: the run.
        options: the options of MuJoCo.
        apart: time between two frames [s]; None: such that the film lasts at most about 15 s.
        width: width of the frames [pixels], a multiple of 32.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import film_frames
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, gains = replace(load_scenario("pool-behind"), time_limit=0.2), load_gains("default")
        >>> run = simulate(mission, load_vehicle("sur400"), gains=gains, law=build_law("closed_form"))
        >>> next(film_frames(run)).shape
        (540, 640, 3)
    """
    from surctl.marine.engine import Scene

    speed = playback_speed(run) if apart is None else 1
    wide, small = ((side, side * 9 // 16) for side in (width, width // 2))
    with (
        Scene(run.scenario, run.vehicle, options=options, size=wide) as large,
        Scene(run.scenario, run.vehicle, options=options, size=small) as little,
    ):
        for step in frame_steps(run, apart=speed / RATE if apart is None else apart):
            moment = moment_of(run, step)
            below = np.hstack([little.picture(camera, moment) for camera in ("side", "nose")])
            yield _labelled(np.vstack([large.picture("above", moment), below]), run, step, speed)


def moment_of(run: Run, step: int) -> Moment:
    """Return what a picture of a control step shows.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import moment_of
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


def _labelled(picture: Picture, run: Run, step: int, speed: int) -> Picture:
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


def _gif(pictures: list[Picture]) -> bytes:
    # one palette for all frames, from some of them; without dithering, which would flicker
    chosen = pictures[:: max(1, len(pictures) // 8)]
    sample = Image.fromarray(np.vstack([picture[::2, ::2] for picture in chosen]))
    palette = sample.quantize(256, method=Image.Quantize.MAXCOVERAGE)  # the median cut loses the colour of the hull
    first, *rest = (Image.fromarray(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
    out = BytesIO()
    duration = [1000 // RATE] * len(rest) + [2000]  # the last frame stays for 2 s
    first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)
    return out.getvalue()
