from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.sonar.array import speed_of_sound
from surctl.marine.world import Box, Disc, Wall, site_walls
from tests.oracles.echoes import fire, true_range
from tests.raycasting import heard_along

QUIET = SonarArray(noise_sd=0.0, bias=0.0)


def test_each_sensor_looks_its_own_way():
    walls = site_walls(5.0, 10.0)
    narrow = SonarArray(beam_angle=0.2)
    ranges = [true_range(narrow, i, position=(4.0, 2.0), heading=0.0, shapes=walls) for i in range(4)]
    assert ranges == pytest.approx([6.0 - 0.27, 3.0 - 0.27, 4.0 - 0.27, 2.0 - 0.27])
    turned = [true_range(narrow, i, position=(4.0, 2.0), heading=math.pi / 2, shapes=walls) for i in range(4)]
    assert turned == pytest.approx(ranges[1:] + ranges[:1])


def test_the_nearest_shape_hides_the_others():
    shapes = (Disc((3.0, 0.0), 0.5), Box((2.0, 0.0), (0.2, 1.0)))
    assert true_range(QUIET, 0, position=(0, 0), heading=0.0, shapes=shapes) == pytest.approx(1.9 - 0.27)
    assert true_range(QUIET, 2, position=(0, 0), heading=0.0, shapes=shapes) == math.inf


@pytest.mark.parametrize("distance", [0.3, 1.0, 2.345, 4.4])
def test_quantisation_is_to_the_nearest_of_255_steps(distance):
    rng = np.random.default_rng(0)
    disc = Disc((0.27 + distance + 0.5, 0.0), 0.5)
    samples = fire(QUIET, 0, position=(0, 0), heading=0.0, shapes=(disc,), noise=rng.standard_normal(5))
    codes = samples / QUIET.resolution
    assert samples.shape == (5,)
    assert codes == pytest.approx(np.rint(codes), abs=1e-9)
    assert np.all(np.abs(samples - distance) <= 0.5 * QUIET.resolution + 1e-12)


def test_resolution_is_the_one_of_e4():
    assert SonarArray().resolution == pytest.approx(0.01765, abs=5e-6)


def test_too_close_reads_the_minimum_and_nothing_reads_the_maximum():
    rng = np.random.default_rng(0)
    array = SonarArray()
    touching = fire(
        array, 0, position=(0, 0), heading=0.0, shapes=(Disc((0.35, 0), 0.05),), noise=rng.standard_normal(5)
    )
    assert np.all(np.abs(touching - array.minimum) <= 0.5 * array.resolution)
    assert np.ptp(touching) == 0.0
    nothing = fire(array, 0, position=(0, 0), heading=0.0, shapes=(), noise=rng.standard_normal(5))
    too_far = fire(array, 0, position=(0, 0), heading=0.0, shapes=(Disc((6.0, 0), 0.5),), noise=rng.standard_normal(5))
    assert np.all(nothing == 4.5) and np.all(too_far == 4.5)


def test_noise_does_not_bring_back_what_is_out_of_range():
    loud, rng = SonarArray(noise_sd=0.5), np.random.default_rng(0)
    beyond = (Disc((loud.hull_radius + 4.51 + 0.5, 0), 0.5),)
    heard = [
        fire(loud, 0, position=(0, 0), heading=0.0, shapes=beyond, noise=rng.standard_normal(5)) for _ in range(20)
    ]
    assert np.all(np.array(heard) == 4.5)


def test_bias_and_noise_are_those_of_the_array():
    array = SonarArray()
    rng = np.random.default_rng(1)
    shapes = (Disc((2.3, 0.0), 0.5),)
    errors = np.array(
        [fire(array, 0, position=(0, 0), heading=0.0, shapes=shapes, noise=rng.standard_normal(5)) for _ in range(2000)]
    ) - (1.8 - 0.27)
    total = math.hypot(array.noise_sd, array.resolution / math.sqrt(12))
    assert errors.mean() == pytest.approx(array.bias, abs=4 * total / math.sqrt(errors.size))
    assert errors.std() == pytest.approx(total, rel=0.05)


def test_a_seed_gives_a_run_and_the_scene_does_not_shift_the_noise():
    array = SonarArray()
    disc = (Disc((2.0, 0.0), 0.5),)

    def second(first_scene):
        rng = np.random.default_rng(5)
        fire(array, 1, position=(0, 0), heading=0.0, shapes=first_scene, noise=rng.standard_normal(5))
        return fire(array, 0, position=(0, 0), heading=0.0, shapes=disc, noise=rng.standard_normal(5))

    assert np.array_equal(second(()), second((Disc((0.0, 1.0), 0.2),)))


def test_firing_order_and_cycle():
    array = SonarArray(order=(0, 2, 1, 3))
    assert [array.sensor_at(k) for k in range(6)] == [0, 2, 1, 3, 0, 2]
    assert array.cycle == pytest.approx(0.1)
    assert SonarArray(azimuths=(0.0,), order=(0,)).cycle == pytest.approx(0.025)


def test_an_uncorrected_constant_of_air_reads_23_cm_for_a_metre_of_water():
    array = SonarArray(noise_sd=0.0, bias=0.0, bits=16, calibrated_for=343.0)
    ahead = (Disc((array.hull_radius + 1.0 + 0.5, 0), 0.5),)
    assert true_range(array, 0, position=(0, 0), heading=0.0, shapes=ahead) == pytest.approx(1.0)
    samples = fire(array, 0, position=(0, 0), heading=0.0, shapes=ahead, noise=np.zeros(5))
    assert samples == pytest.approx(343.0 / speed_of_sound(20.0), abs=array.resolution)
    assert np.round(samples, 2) == pytest.approx(0.23)
    nothing = fire(array, 0, position=(0, 0), heading=0.0, shapes=(), noise=np.zeros(5))
    assert np.all(nothing == array.maximum)
    touching = (Disc((array.hull_radius + 0.02 + 0.5, 0), 0.5),)
    low = fire(array, 0, position=(0, 0), heading=0.0, shapes=touching, noise=np.zeros(5))
    assert low == pytest.approx(0.2 * array.scale, abs=array.resolution)


def test_a_constant_too_large_reads_no_further_than_the_maximum():
    array = SonarArray(noise_sd=0.0, bias=0.0, calibrated_for=1600.0)
    samples = fire(array, 0, position=(0, 0), heading=0.0, shapes=(Disc((5.2, 0), 0.5),), noise=np.zeros(5))
    assert np.all(samples == array.maximum)


def test_the_temperature_changes_the_reading_of_a_fixed_constant():
    warm = SonarArray(temperature=30.0, calibrated_for=speed_of_sound(20.0))
    cold = SonarArray(temperature=5.0, calibrated_for=speed_of_sound(20.0))
    assert warm.scale < 1 < cold.scale
    assert SonarArray(temperature=30.0).scale == 1.0


def test_the_blind_range_is_half_the_way_of_the_blind_time():
    array = SonarArray(blind_time=4e-4)
    assert array.blind == pytest.approx(0.5 * speed_of_sound(20.0) * 4e-4)
    assert SonarArray().blind == SonarArray().lowest == 0.2
    ahead = (Disc((array.hull_radius + 0.05 + 0.5, 0), 0.5),)
    samples = fire(array, 0, position=(0, 0), heading=0.0, shapes=ahead, noise=np.zeros(5))
    assert samples == pytest.approx(array.blind, abs=0.5 * array.resolution)


def test_only_what_faces_the_sensor_is_heard():
    box = (Box((2.0, 0.0), (1.0, 1.0), math.pi / 4),)
    narrow = {"beam_angle": math.radians(15)}
    corner = 2.0 - math.sqrt(0.5) - 0.27
    assert true_range(SonarArray(**narrow), 0, position=(0, 0), heading=0.0, shapes=box) == pytest.approx(corner)
    limited = SonarArray(**narrow, incidence_limit=math.radians(22.5))
    assert true_range(limited, 0, position=(0, 0), heading=0.0, shapes=box) == math.inf


@pytest.mark.parametrize("count", [1, 2, 3, 6, 8])
def test_any_number_of_sensors(count):
    azimuths = tuple(2 * math.pi * k / count for k in range(count))
    array = SonarArray(azimuths=azimuths, order=tuple(range(count)), firing_period=0.1 / count)
    assert array.size == count and len(array.cones) == count and array.cycle == pytest.approx(0.1)
    assert hash(array) == hash(replace(array)) and array == replace(array)
    wall = site_walls(8.0, 8.0)
    for sensor in range(count):
        assert 0 < true_range(array, sensor, position=(4, 4), heading=0.1, shapes=wall) <= 4.0 - 0.27 + 2.0


@pytest.mark.parametrize("degrees", [15, 75, 120, 179])
def test_beams_up_to_a_half_circle(degrees):
    array = SonarArray(beam_angle=math.radians(degrees), pitch=0.0)
    beside = (Disc((0.27 + math.cos(math.radians(degrees / 2)), math.sin(math.radians(degrees / 2))), 0.01),)
    assert true_range(array, 0, position=(0, 0), heading=0.0, shapes=beside) == pytest.approx(0.99)
    assert true_range(array, 0, position=(0, 0), heading=0.1, shapes=beside) < math.inf
    assert true_range(array, 0, position=(0, 0), heading=-0.1, shapes=beside) == math.inf


def test_a_module_of_whole_centimetres():
    module = SonarArray(step=0.01, noise_sd=0.0, bias=0.0)
    assert module.resolution == pytest.approx(0.01) and module.top_code == 450
    shapes = (Wall((1.5 + module.hull_radius, 0.0), (-1.0, 0.0)),)
    samples = fire(module, 0, position=(0, 0), heading=0.0, shapes=shapes, noise=np.zeros(5))
    np.testing.assert_allclose(samples, 1.5, atol=1e-12)
    with pytest.raises(InputError, match=r"step = 0\.4: must divide the maximum"):
        SonarArray(step=0.4)


def test_windows_must_hold_the_echo():
    with pytest.raises(InputError, match=r"makes firings overlap: an echo from it takes 25\.2 ms in water") as caught:
        SonarArray(maximum=18.7)
    assert caught.value.key == "array.maximum"
    assert SonarArray(maximum=18.5).echo_time <= 0.025
    with pytest.raises(InputError, match="is too long for the cycle"):
        SonarArray(maximum=80.0)
    with pytest.raises(InputError, match=r"longer than the cycle limit of 0\.05 s; give 0\.0125 s"):
        SonarArray(cycle_limit=0.05)
    # five pings one after another would not fit: a firing is one ping
    assert 5 * SonarArray().echo_time > SonarArray().firing_period


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"incidence_limit": 0.0}, "array.incidence_limit"),
        ({"incidence_limit": math.pi / 2}, "array.incidence_limit"),
        ({"incidence_limit": math.nan}, "array.incidence_limit"),
        ({"temperature": -1.0}, "array.temperature"),
        ({"temperature": math.nan}, "array.temperature"),
        ({"calibrated_for": 0.0}, "array.calibrated_for"),
        ({"calibrated_for": math.inf}, "array.calibrated_for"),
        ({"calibrated_for": 1e5}, "array.calibrated_for"),
        ({"blind_time": 4e-4, "minimum": 0.3}, "array.blind_time"),
        ({"blind_time": 0.0}, "array.blind_time"),
        ({"blind_time": 0.01}, "array.blind_time"),
        ({"cycle_limit": 0.0}, "array.cycle_limit"),
        ({"firing_period": 0.03}, "array.firing_period"),
        ({"firing_period": 0.0}, "array.firing_period"),
        ({"firing_period": math.nan}, "array.firing_period"),
        ({"order": (0, 1, 2, 2)}, "array.order"),
        ({"azimuths": ()}, "array.azimuths"),
        ({"azimuths": (0.0, math.nan, 1.0, 2.0)}, "array.azimuths"),
        ({"beam_angle": 3.2}, "array.beam_angle"),
        ({"minimum": 5.0}, "array.minimum, maximum"),
        ({"minimum": math.nan}, "array.minimum, maximum"),
        ({"bits": 0}, "array.bits"),
        ({"samples": 0}, "array.samples"),
        ({"noise_sd": -0.1}, "array.noise_sd"),
        ({"bias": math.inf}, "array.bias"),
        ({"hull_radius": math.inf}, "array.hull_radius"),
    ],
)
def test_mistakes_are_named(values, key):
    with pytest.raises(InputError) as caught:
        SonarArray(**values)
    assert caught.value.key == key


def test_unknown_sensor_and_nan_pose_are_refused():
    with pytest.raises(InputError, match="no such sensor"):
        true_range(QUIET, 4, position=(0, 0), heading=0.0, shapes=())
    with pytest.raises(InputError, match="finite"):
        true_range(QUIET, 0, position=(0, math.nan), heading=0.0, shapes=())


@pytest.mark.parametrize(
    ("limit", "beam", "mount"),
    [(22.5, 75, None), (5, 75, None), (5, 75, (0.1, 0.3))],  # others: study 40
)
def test_a_corner_is_first_heard_where_rays_first_find_a_face_that_answers(limit, beam, mount):
    array = SonarArray(
        azimuths=(0.0,), order=(0,), mounts=None if mount is None else (mount,), beam_angle=math.radians(beam)
    )
    at, box = array.corner_range(math.radians(limit)), Box((math.sqrt(2), 0.0), (2.0, 2.0), math.pi / 4)

    def heard(away):
        for heading in np.radians(np.arange(-180, 180, 0.25)):
            x, y, axis = array.apex(0, position=(-array.hull_radius - away, 0.0), heading=heading)
            for offset, half in array.cones[0]:
                looks = axis + offset + np.linspace(-half, half, 301)
                if np.isfinite(heard_along([box], (x, y), looks, limit=math.radians(limit))).any():
                    return True
        return False

    assert not heard(at + 0.01)
    assert heard(at - 0.01) if at > 0 else (limit, beam, mount) == (5, 75, None)


def test_a_corner_of_faces_that_answer_from_the_bisector_is_heard_at_the_longest_range():
    assert [SonarArray().corner_range(limit) for limit in (None, math.pi / 4)] == [4.5, 4.5]
