"""Films as MP4, by the program ffmpeg or, without it, by the package PyAV."""

from __future__ import annotations

import importlib
import subprocess
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing

__all__ = ["check_mp4", "mp4"]

Frame = NDArray[np.uint8]


def check_mp4(path: Path, *, key: str) -> None:
    """Raise ToolMissing if nothing here writes MP4; `key` is the option that names the file."""
    if which("ffmpeg") is None and find_spec("av") is None:
        remedy = "pip install 'surctl[film]', install ffmpeg, or end the name in .gif"
        raise ToolMissing("needs PyAV or ffmpeg, and neither is installed", key=key, value=str(path), remedy=remedy)


def mp4(pictures: Iterator[Frame], *, rate: int, key: str) -> bytes:
    """Return a film (H.264) of pictures (height, width, 3) whose sides are even, with `rate` pictures a second."""
    return (_by_av if which("ffmpeg") is None else _by_ffmpeg)(pictures, rate, key)


def _by_av(pictures: Iterator[Frame], rate: int, key: str) -> bytes:
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


def _by_ffmpeg(pictures: Iterator[Frame], rate: int, key: str) -> bytes:
    first = next(pictures)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = ["-f", "rawvideo", "-pixel_format", "rgb24", "-video_size", size, "-framerate", str(rate), "-i", "-"]
    with TemporaryDirectory() as folder:
        target = Path(folder) / "run.mp4"
        command = ["ffmpeg", "-loglevel", "error", *raw, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        sent = b"".join([first.tobytes(), *(p.tobytes() for p in pictures)])
        done = subprocess.run(command, input=sent, capture_output=True, check=False)
        if done.returncode or not target.exists():
            said = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise InputError(f"ffmpeg failed ({said[-1]})", key=key, remedy="end the name in .gif")
        return target.read_bytes()
