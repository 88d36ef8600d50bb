"""The map of a log: a TOML file that says which fields are position, attitude, velocity and thrust."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from surctl.files import Strict, read_toml, validate
from surctl.marine.vehicle.frames import Frame

__all__ = ["Attitude", "LogMap", "Position", "Rates", "Source", "Thrust", "Velocity", "load_log_map"]

Positive = Annotated[float, Field(gt=0)]


class Source(Strict):
    """Fields of one topic; the topic of a table has an empty name."""

    topic: str = ""
    fields: list[str] = Field(min_length=1)


class Position(Source):
    """Position x, y, z in the world frame; without z, x and y; "" for a coordinate that was not measured."""

    fields: list[str] = Field(min_length=2, max_length=3)
    unit: str = "m"


class Attitude(Source):
    """Heading alone, or roll, pitch and heading, or a quaternion x, y, z, w (body to world)."""

    unit: str = "rad"

    @model_validator(mode="after")
    def _known(self) -> Attitude:
        if len(self.fields) not in (1, 3, 4):
            raise ValueError(
                "needs 1 field (heading), 3 (roll, pitch, heading) or 4 (quaternion x, y, z, w); correct it"
            )
        return self


class Velocity(Source):
    """Velocity over ground: in the body frame, in the heading frame (turned by the heading alone), or in the world.

    A component that was not measured has the name "".
    """

    fields: list[str] = Field(min_length=2, max_length=3)
    unit: str = "m/s"
    frame: Literal["body", "heading", "world"]


class Rates(Source):
    """Yaw rate alone, or the body rates p, q, r, from which the rate of the heading follows with the attitude."""

    unit: str = "rad/s"

    @model_validator(mode="after")
    def _known(self) -> Rates:
        if len(self.fields) not in (1, 3):
            raise ValueError("needs 1 field (yaw rate) or 3 (p, q, r); correct it")
        return self


class Thrust(Source):
    """Forces along the body axes and yaw moment; or commands of thrusters, with their curve and the frame matrix.

    Attributes:
        fields: Fu, Fv, Fw, Fr, "" for an axis without thrust; or with `matrix`, the command of each thruster.
        unit: unit of the forces; of commands, the texts pwm or 1 for plain numbers, or N for forces of thrusters. Plain
            numbers need a curve, or a matrix in N and N m per command.
        moment_unit: unit of Fr.
        command: commands of the curve, increasing; at a command outside them the thrust is not known.
        force_N: force of a thruster for each command [N].
        matrix: rows surge, sway, heave [1] and yaw [m], one column per thruster.
        hold_s: longest time for which a command counts [s]; default: one second or ten periods.
    """

    unit: str = "N"
    moment_unit: str = "N m"
    command: list[float] | None = Field(default=None, min_length=2)
    force_N: list[float] | None = Field(default=None, min_length=2)  # noqa: N815  # the key of the file, with its unit
    matrix: list[list[float]] | None = Field(default=None, min_length=4, max_length=4)
    hold_s: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Thrust:
        if self.matrix is None:
            if self.command is not None or self.force_N is not None:
                raise ValueError("has a curve, but no matrix; add matrix with the rows surge, sway, heave, yaw")
            if len(self.fields) != 4:
                raise ValueError(
                    'needs 4 fields Fu, Fv, Fw, Fr ("" for an axis without thrust), or a matrix; correct it'
                )
            return self
        if any(len(row) != len(self.fields) for row in self.matrix):
            raise ValueError(f"each row of matrix needs {len(self.fields)} numbers, one per field; correct it")
        if (self.command is None) != (self.force_N is None):
            raise ValueError("command and force_N belong together; give both")
        if self.command is not None and self.force_N is not None:
            if len(self.command) != len(self.force_N):
                raise ValueError("command and force_N need the same number of entries; correct them")
            if not (np.diff(self.command) > 0).all():
                raise ValueError("command must increase; sort the curve")
        return self

    def body_force(self, commands: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the thrust (n, 4) [N, N m] of thruster commands (n, thrusters); NaN where one is outside the curve.

        Commands such as 0 and 65535 mean that there is no pulse, not full thrust.
        """
        force = commands
        if self.command is not None:
            force = np.interp(commands, self.command, self.force_N or [], left=np.nan, right=np.nan)
        return np.asarray(force @ np.array(self.matrix).T)


class Clock(Strict):
    """Time, frame and common period of a log.

    Attributes:
        frame: world and body axes of all sources: enu (ENU/FLU) or ned (NED/FRD).
        time: column of the time, in a table.
        time_unit: its unit.
        columns: names of the columns of a table without a header, from the left.
        skip_lines: lines above the numbers of such a table.
        stamp: topics whose time is the field of this name instead of the recorder's (`header.stamp`).
        shift_s: seconds to add to the time of a topic, for a clock of its own.
        period_s: common period; default: the times of the velocity, else of the position, else of the attitude.
    """

    frame: Frame
    time: str = "t_s"
    time_unit: str = "s"
    columns: list[str] | None = Field(default=None, min_length=2)
    skip_lines: int = Field(default=0, ge=0)
    stamp: dict[str, str] = Field(default_factory=dict)
    shift_s: dict[str, float] = Field(default_factory=dict)
    period_s: Positive | None = None

    @model_validator(mode="after")
    def _named(self) -> Clock:
        twice = sorted({name for name in self.columns or () if (self.columns or []).count(name) > 1})
        if twice:
            raise ValueError(f"columns names {twice[0]} twice; rename one of them")
        if self.skip_lines and self.columns is None:
            raise ValueError("skip_lines needs columns, the names of the columns; add them")
        return self


class LogMap(Strict):
    """The content of a map file."""

    kind: Literal["log-map"]
    log: Clock
    position: Position | None = None
    attitude: Attitude | None = None
    velocity: Velocity | None = None
    rates: Rates | None = None
    thrust: Thrust

    @model_validator(mode="after")
    def _complete(self) -> LogMap:
        if all(part is None for part in (self.position, self.attitude, self.velocity, self.rates)):
            raise ValueError("has no motion; add [position], [attitude], [velocity] or [rates]")
        if self.velocity is not None and self.velocity.frame == "world" and self.attitude is None:
            raise ValueError("velocity in the world frame needs [attitude]; add it")
        if self.rates is not None and len(self.rates.fields) == 3 and len(getattr(self.attitude, "fields", ())) < 3:
            raise ValueError("rates p, q, r need [attitude] with roll and pitch; add it, or give the yaw rate alone")
        return self

    def sources(self) -> list[tuple[str, Source]]:
        """Return the parts of the map with their names."""
        named = [(name, getattr(self, name)) for name in ("position", "attitude", "velocity", "rates", "thrust")]
        return [(name, part) for name, part in named if part is not None]


def load_log_map(path: Path) -> LogMap:
    """Read the map of a log.

    Raises:
        InputError: the file cannot be read, or a key is unknown, missing or wrong.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle.logs.log_map import load_log_map
        >>> text = 'kind = "log-map"\\n[log]\\nframe = "ned"\\n[rates]\\nfields = ["r"]\\n[thrust]\\n'
        >>> _ = Path("map.toml").write_text(text + 'fields = ["Fx", "", "", "Mz"]\\n')
        >>> load_log_map(Path("map.toml")).log.frame
        'ned'
    """
    return validate(read_toml(path), LogMap, file=path)
