"""Evaluators of chunks for worker processes, which load no more than they need."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

CHUNKS = [(k, np.arange(3.0)[:, None] + 3 * k) for k in range(40)]


def slow_squares(index, points):
    """A chunk's evaluator that leaves a trace of every evaluation and takes a moment."""
    with Path(os.environ["SURCTL_TEST_TRACE"]).open("a") as file:
        file.write(f"{index}\n")
    time.sleep(float(os.environ.get("SURCTL_TEST_PAUSE", "0.001")))
    return np.column_stack([points[:, 0] ** 2, np.sin(points[:, 0]) + index])


def own_number(index, points):
    """The worker's process, and squares; takes a moment of processor time."""
    _work(0.01)
    return np.column_stack([np.full(len(points), float(os.getpid())), points[:, 0] ** 2 + index])


def slow_to_start(index, points):
    """`own_number`, whose first chunk takes a moment more, as one that builds what the others use."""
    _work(0.0 if index else 0.25)
    return own_number(index, points)


def _work(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
