"""Vehicles that roll and pitch are fitted to logs with roll and pitch: truth in the intervals, columns, directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    LOG_MOTION,
    LOG_THRUST,
    LOG_TILT,
    PLANT_DISTURBANCE,
    TERMS,
    MotionLog,
    Parameter,
    Vehicle,
    identify,
    load_vehicle,
    plant_parameters,
    plant_state,
    predict,
)
from surctl.marine.vehicle.logs.read import read_mapped_log
from surctl.marine.vehicle.motion_log import read_motion_log

G = 9.81
TILT = {
    "mpp": 0.30, "mqq": 0.35, "weight": 11.5 * G, "buoyancy": 11.6 * G, "zg": -0.04, "zt": 0.05,
    "Kp": 0.4, "Mq": 0.5, "Kpp": 0.9, "Mqq": 1.1, "muq": 0.20,
}  # fmt: skip


def boat(values: dict[str, float]) -> Vehicle:
    plain = load_vehicle("bluerov2-wu")
    added = {name: Parameter(values[name], TERMS[name].unit, None, "test") for name in TERMS if name in values}
    return replace(plain, parameters={**plain.parameters, **added})


TRUE = boat(TILT)
START = boat({**TILT, "mpp": 0.4, "mqq": 0.25, "zg": -0.06, "Kp": 0.3, "Mqq": 1.5, "muq": 0.1})


def made_log(
    vehicle: Vehicle, *, seed: int, rows: int = 200, push: float = 0.3, tilt: tuple[float, float] = (0.0, 0.0)
) -> MotionLog:
    """Random steps of thrust, motion of all six axes with noise of 3 mm and 3 mrad."""
    rng = np.random.default_rng(seed)
    held = [np.repeat(rng.uniform(-1, 1, rows), rng.integers(6, 30, rows))[:rows] for _ in range(4)]
    thrust = push * vehicle.thrust_limit * np.column_stack(held)
    step, p, still = advance(vehicle.form), plant_parameters(vehicle), PLANT_DISTURBANCE.pack()
    x = plant_state(vehicle.form).pack({"tau": thrust[0], "tilt": [*tilt, 0.0, 0.0]})
    motion = []
    for command in thrust:
        motion.append(np.concatenate([x[:8], x[12:]]))
        for _ in range(4):  # of 25 ms
            x = np.asarray(step(x, command, still, p)).reshape(-1)
    noise = 0.003 * rng.normal(size=(rows, 12))
    return MotionLog(0.1 * np.arange(rows), np.array(motion) + noise, thrust, "log.csv")


def test_six_degrees_of_freedom_are_fitted_with_their_truth_in_the_intervals() -> None:
    log = made_log(TRUE, seed=2)
    found = identify(log, START, name="fitted")
    inside = {k: abs(v - (TRUE[k] if k in TRUE.parameters else 0.0)) <= h for k, (v, h) in found.estimates.items()}
    assert sum(inside.values()) >= len(inside) - 4, inside  # 27 at 95 %: more than 4 outside in 1 of 100
    assert {"mpp", "mqq", "Kp", "Mq", "Kpp", "Mqq", "muq", "zg", "m11", "m44"} <= set(found.identified)
    assert found.vehicle["zg"] == pytest.approx(-0.04, abs=0.001) and found.vehicle["weight"] == TRUE["weight"]
    assert not {"xg", "Z0"} & set(found.vehicle.parameters) - {k for k, h in inside.items() if not h}
    assert set(found.noise) == {*LOG_MOTION, *LOG_TILT} and found.noise["roll_rad"] == pytest.approx(0.003, rel=0.2)
    predicted = predict(log, found.vehicle)
    assert predicted.model["pitch_rad"] < 0.3 * predicted.hold["pitch_rad"] and predicted.predicted.shape[1] == 12


def test_roll_and_pitch_must_be_in_the_log_and_below_90_degrees() -> None:
    log = made_log(TRUE, seed=3, rows=60)
    with pytest.raises(InputError, match="contains neither roll nor pitch"):
        identify(replace(log, motion=log.motion[:, :8]), START, name="fitted")
    over = log.motion.copy()
    over[30, 9] = 1.7
    with pytest.raises(InputError, match=r"pitch_rad = 1\.7: at 3 s"):
        identify(replace(log, motion=over), START, name="fitted")
    # a vehicle without roll and pitch is fitted to the other columns
    assert set(identify(log, load_vehicle("bluerov2-wu"), name="fitted").noise) == set(LOG_MOTION)


def test_roll_and_pitch_are_columns_of_a_log(tmp_path: Path) -> None:
    log = made_log(TRUE, seed=4, rows=60)
    names = ("t_s", *LOG_MOTION, *LOG_TILT, *LOG_THRUST)
    file = tmp_path / "log.csv"
    numbers = np.column_stack([log.time, log.motion, log.thrust])
    np.savetxt(file, numbers, delimiter=",", header=",".join(names).replace("roll_rad", "roll_deg"), comments="")
    read = read_motion_log(file)
    np.testing.assert_allclose(read.motion[:, 9:], log.motion[:, 9:], atol=1e-12)
    np.testing.assert_allclose(read.motion[:, 8], np.radians(log.motion[:, 8]), atol=1e-12)
    down = read_motion_log(file, frame="ned")
    np.testing.assert_allclose(down.motion[:, 8:], read.motion[:, 8:] * [1, -1, 1, -1], atol=1e-12)


def test_a_quaternion_and_body_rates_give_roll_pitch_p_and_q(tmp_path: Path) -> None:
    log = made_log(TRUE, seed=5, rows=60)
    roll, pitch, yaw = log.motion[:, 8], log.motion[:, 9], log.motion[:, 3]
    (a, b, c), (d, e, f) = (function(np.array([roll, pitch, yaw]) / 2) for function in (np.cos, np.sin))
    quaternion = [d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c, a * b * c + d * e * f]
    numbers = np.column_stack([log.time, *quaternion, log.motion[:, 10:], log.motion[:, 7], log.thrust])
    names = ["t_s", *("qx", "qy", "qz", "qw"), *("p", "q", "r"), *LOG_THRUST]
    np.savetxt(tmp_path / "log.csv", numbers, delimiter=",", header=",".join(names), comments="")
    (tmp_path / "map.toml").write_text(
        'kind = "log-map"\nlog = { frame = "enu" }\nattitude = { fields = ["qx", "qy", "qz", "qw"] }\n'
        'rates = { fields = ["p", "q", "r"] }\n[thrust]\nfields = ["Fu_N", "Fv_N", "Fw_N", "Fr_N_m"]\n'
    )
    read = read_mapped_log(tmp_path / "log.csv", tmp_path / "map.toml")
    np.testing.assert_allclose(read.motion[:, 8:], log.motion[: len(read.time), 8:], atol=1e-9)
    (tmp_path / "wrong.toml").write_text((tmp_path / "map.toml").read_text().replace('"qw"', '"Fu_N"'))
    with pytest.raises(InputError, match=r"wrong.toml: attitude.fields = .* not a unit quaternion: norm \S+ to [1-9]"):
        read_mapped_log(tmp_path / "log.csv", tmp_path / "wrong.toml")
