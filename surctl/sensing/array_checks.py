"""What makes an array impossible, told by the field that is wrong."""

from __future__ import annotations

from math import isfinite, pi
from typing import TYPE_CHECKING

from surctl.errors import InputError
from surctl.sensing.mounting import inside_hull

if TYPE_CHECKING:
    from surctl.sensing.array import SonarArray

__all__ = ["check_array"]

_SLACK = 1e-9  # s


def check_array(array: SonarArray) -> None:
    """InputError, keyed `array.<field>`, for the first value that no array can have."""
    _check_geometry(array)
    _check_mounts(array)
    _check_conversion(array)
    _check_sound(array)
    _check_timing(array)


def _require(holds: bool, problem: str, *, key: str, value: object, remedy: str) -> None:
    if not holds:
        raise InputError(problem, key=f"array.{key}", value=value, remedy=remedy)


def _check_geometry(array: SonarArray) -> None:
    _require(
        array.size > 0 and all(isfinite(a) for a in array.azimuths),
        "must be finite angles, at least one",
        key="azimuths",
        value=array.azimuths,
        remedy="give radians, counter-clockwise from forward",
    )
    _require(
        isfinite(array.hull_radius) and array.hull_radius >= 0,
        "must be at least 0",
        key="hull_radius",
        value=array.hull_radius,
        remedy="give m",
    )
    _require(
        0 < array.beam_angle < pi,
        "must lie between 0 and pi",
        key="beam_angle",
        value=array.beam_angle,
        remedy="give the full angle in radians",
    )
    limit = array.incidence_limit
    _require(
        limit is None or 0 < limit < pi / 2,
        "must lie between 0 and pi/2",
        key="incidence_limit",
        value=limit,
        remedy="give radians, or None when every surface reflects",
    )


def _check_mounts(array: SonarArray) -> None:
    if array.mounts is None:
        return
    _require(
        len(array.mounts) == array.size and all(len(m) == 2 and isfinite(m[0] + m[1]) for m in array.mounts),
        f"must be {array.size} finite points, one for each azimuth",
        key="mounts",
        value=array.mounts,
        remedy="give x, y in {B} in m, or None: on the hull",
    )
    for i, mount in enumerate(array.mounts):
        _require(
            not inside_hull(mount, array.hull_radius),
            f"sensor {i} lies inside the hull of radius {array.hull_radius:g} m",
            key="mounts",
            value=mount,
            remedy="move it out to the hull or beyond",
        )


def _check_conversion(array: SonarArray) -> None:
    _require(
        isfinite(array.maximum) and 0 < array.minimum < array.maximum,
        "must hold 0 < minimum < maximum",
        key="minimum, maximum",
        value=(array.minimum, array.maximum),
        remedy="give m, shortest range first",
    )
    whole = isinstance(array.bits, int) and isinstance(array.samples, int)
    _require(
        whole and 1 <= array.bits <= 24 and array.samples >= 1,
        "must be whole numbers, bits 1 to 24, samples at least 1",
        key="bits, samples",
        value=(array.bits, array.samples),
        remedy="the paper has 8 bits, 5 samples",
    )
    _require(
        isfinite(array.noise_sd) and array.noise_sd >= 0 and isfinite(array.bias),
        "must be finite, noise at least 0",
        key="noise_sd, bias",
        value=(array.noise_sd, array.bias),
        remedy="give m",
    )


def _check_sound(array: SonarArray) -> None:
    try:
        speed = array.speed
    except InputError as error:
        raise InputError(error.problem, key=f"array.{error.key}", value=error.value, remedy=error.remedy) from None
    _require(
        array.calibrated_for is None or (isfinite(array.calibrated_for) and array.calibrated_for > 0),
        "must be greater than 0",
        key="calibrated_for",
        value=array.calibrated_for,
        remedy="give m/s, or None: the true speed",
    )
    if array.blind_time is not None:
        _require(
            array.minimum == type(array).minimum,
            "is a second blind range, beside minimum",
            key="blind_time",
            value=array.blind_time,
            remedy="give blind_time or minimum, not both",
        )
        _require(
            isfinite(array.blind_time) and 0 < 0.5 * speed * array.blind_time < array.maximum,
            "must be greater than 0, and its range below the maximum",
            key="blind_time",
            value=array.blind_time,
            remedy=f"give less than {2.0 * array.maximum / speed:.3g} s",
        )
    _require(
        array.lowest < array.maximum,
        f"makes every reading the maximum, being {array.scale:.3g} times the true speed",
        key="calibrated_for",
        value=array.calibrated_for,
        remedy=f"give about {speed:.0f} m/s, or None: the true speed",
    )


def _check_timing(array: SonarArray) -> None:
    _require(
        sorted(array.order) == list(range(array.size)),
        "must name every sensor once",
        key="order",
        value=array.order,
        remedy=f"write an order of 0 to {array.size - 1}",
    )
    _require(
        isfinite(array.firing_period) and array.firing_period > 0,
        "must be greater than 0",
        key="firing_period",
        value=array.firing_period,
        remedy="give s",
    )
    _require(
        isfinite(array.cycle_limit) and array.cycle_limit > 0,
        "must be greater than 0",
        key="cycle_limit",
        value=array.cycle_limit,
        remedy="give s",
    )
    _require(
        array.cycle <= array.cycle_limit + _SLACK,
        f"makes a cycle of {array.cycle:g} s, longer than {array.cycle_limit:g} s",
        key="firing_period",
        value=array.firing_period,
        remedy=f"at most {array.cycle_limit / array.size:g} s for {array.size} sensors",
    )
    echo = f"its echo takes {1e3 * array.echo_time:.1f} ms in {array.medium}"
    _require(
        array.echo_time <= array.cycle_limit + _SLACK,
        f"range beyond the cycle: {echo}, longer than a cycle of {array.cycle_limit:g} s",
        key="maximum",
        value=array.maximum,
        remedy=f"at most {0.5 * array.speed * array.firing_period:.3g} m",
    )
    _require(
        array.echo_time <= array.firing_period + _SLACK,
        f"overlapping firing windows: {echo}, the next sensor fires after {1e3 * array.firing_period:g} ms",
        key="maximum",
        value=array.maximum,
        remedy=f"at most {0.5 * array.speed * array.firing_period:.3g} m, or a longer firing_period",
    )
