"""Faces through the last echoes of a run: where a face may go on beside what was heard of it.

A face answers at the foot of the perpendicular, so a robot that comes diagonally to a face needs the map at places that
have not answered yet. Close to the hull most directions lie between two beams: 0.1 m from it, four beams cover 88 of
360 degrees. The faces are computed anew from the last firings, so a wrong one stays for no longer than these.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from recorded import Array, Firing
from tracker import EDGE, wrapped

from surctl.marine.sensing import SonarArray

INCIDENCE = np.radians(22.5)  # rad: a face may be silent beyond this angle to its normal, as `webots` surfaces are
AGREES = 0.03  # m: 2.5 standard deviations of a reading (`SPREAD` of `tracker.py`)
WINDOW = 4.0  # s before the last firing that is not blind; four beams sweep all directions in 3.5 s at 0.45 rad/s
LEAST = 10  # echoes that a face must explain: those of one beam within 1 s
GOES_ON = 0.4  # m by which a face goes on unheard: the way within 2.7 s, while no beam covers a bearing, at 0.15 m/s
BEARINGS = 16  # candidate normals over the width of a beam
OTHER_BEAM = 0.3  # rad between the axes of two echoes that each start a face
GRAIN = 0.05  # m between two places of a face


class Faces:
    """The firings of the last seconds before the last one that was not blind, and the faces that explain them."""

    COUNT = 4  # faces, one for each beam

    def __init__(self, array: SonarArray) -> None:
        self.half = array.half_angle
        self.rows = np.zeros((0, 5))  # apex x, y, axis, reading, time
        self.echo = np.zeros(0, dtype=bool)  # whether an unknown surface answered

    def add(self, firing: Firing) -> None:
        """Remember a firing; one from within the blind range has no distance, and leaves the faces as they are."""
        if firing.blind:
            return
        self.rows = np.vstack([self.rows, [*firing.apex, firing.axis, firing.reading, firing.time]])
        self.echo = np.append(self.echo, not firing.silent and not firing.known)
        stays = self.rows[:, 4] > firing.time - WINDOW
        self.rows, self.echo = self.rows[stays], self.echo[stays]

    def places(self) -> Array:
        """Return places (n, 2) [m] on the faces, at most `GRAIN` apart."""
        anchors: list[int] = []
        for k in np.flatnonzero(self.echo)[::-1]:
            if len(anchors) < self.COUNT and all(
                abs(wrapped(self.rows[k, 2] - self.rows[j, 2])) > OTHER_BEAM for j in anchors
            ):
                anchors.append(int(k))
        return np.concatenate([np.zeros((0, 2)), *(self._face(k) for k in anchors)])

    def _face(self, k: int) -> Array:
        # the face at the distance of echo `k` whose normal explains most echoes and contradicts fewest firings
        apex, axis, reading = self.rows[:, :2], self.rows[:, 2], self.rows[:, 3]
        bearing = axis[k] + np.linspace(-self.half, self.half, BEARINGS)
        normal = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        depth = reading[k] + normal @ apex[k]
        off = np.abs(wrapped(bearing[:, None] - axis))
        predicted = (depth[:, None] - normal @ apex.T) / np.cos(np.clip(off - self.half, 0, INCIDENCE))
        error = reading - predicted
        explained: NDArray[np.bool_] = self.echo & (off < self.half + INCIDENCE) & (np.abs(error) < AGREES)
        foot = off < self.half - EDGE  # the foot of the perpendicular is in the beam
        against = foot & (np.abs(error) > AGREES)
        fit = ((error / AGREES) ** 2 * explained).sum(axis=1)
        best = int(np.argmax(explained.sum(axis=1) - against.sum(axis=1) - fit))
        if explained[best].sum() < LEAST:
            return np.zeros((0, 2))
        tangent = np.array([-normal[best, 1], normal[best, 0]])
        along = apex @ tangent
        heard, ends = along[explained[best]], along[foot[best] & (error[best] > AGREES)]
        low = max(heard.min() - GOES_ON, ends[ends < along[k]].max(initial=-np.inf))
        high = min(heard.max() + GOES_ON, ends[ends > along[k]].min(initial=np.inf))
        return np.asarray(depth[best] * normal[best] + np.arange(low, high + GRAIN, GRAIN)[:, None] * tangent)
