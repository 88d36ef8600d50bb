"""A run as a file: what other programs read back is the run, with its units and its frame."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.io import loadmat, savemat

from surctl.errors import InputError
from surctl.files import file_name
from surctl.marine.control import load_gains
from surctl.marine.simulation import Run, load_scenario, save_record, simulate
from surctl.marine.simulation.record_file import RECORD_FORMATS, record_columns
from surctl.marine.study.plan import write_missions
from surctl.marine.vehicle import FRAME_TEXT, FRAMES, LOG_MOTION, LOG_THRUST, load_vehicle
from surctl.marine.vehicle.motion_log import read_motion_log, swap_body, swap_pose

UNITS = {"t_s": "s", "psi_rad": "rad", "r_rad_per_s": "rad/s", "Fr_N_m": "N m", "clearance_m": "m", "status": "1"}


@cache
def _run() -> Run:
    scenario = load_scenario("pool-behind")
    return simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"))


def _columns(run: Run, frame: str) -> dict[str, np.ndarray]:
    """What each column is, from the record alone."""
    r = run.record
    eta, nu, tau = (r.eta, r.nu, r.tau) if frame == "enu" else (swap_pose(r.eta), swap_body(r.nu), swap_body(r.tau))
    found = {"t_s": r.time, "clearance_m": r.clearance, "status": r.status}
    for names, values in ((LOG_MOTION[:4], eta), (LOG_MOTION[4:], nu), (LOG_THRUST, tau)):
        found |= dict(zip(names, values.T, strict=True))
    return found


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "a\\b", ".hidden", "CON: x*?", "x" * 300, "..", ""])
def test_a_name_never_leads_out_of_the_folder(name: str, tmp_path: Path) -> None:
    run = replace(_run(), scenario=replace(_run().scenario, name=name))
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    for kind in ("csv", "mcap"):
        assert save_record(run, folder, kind=kind).resolve().parent == folder.resolve()
    assert write_missions([replace(run.scenario, source="")], folder)[0].source.startswith(f"{folder}/")
    assert all(path.parent == folder for path in tmp_path.rglob("*.*")) and len(list(folder.iterdir())) == 4
    assert file_name(name) != file_name(name + "/")


@pytest.mark.parametrize("frame", FRAMES)
def test_matlab_reads_the_run_to_the_last_bit(tmp_path: Path, frame: str) -> None:
    read = loadmat(save_record(_run(), tmp_path, kind="mat", frame=frame))
    for name, values in _columns(_run(), frame).items():
        assert read[name].shape == (len(values), 1)
        np.testing.assert_array_equal(read[name][:, 0], values, err_msg=name)
    assert {name: read["units"][name][0, 0][0] for name in UNITS} == UNITS
    assert read["frame"][0] == FRAME_TEXT[frame]  # type: ignore[index]
    assert "scenario=pool-behind" in read["about"][0]


@pytest.mark.parametrize("frame", FRAMES)
def test_xarray_reads_the_run_to_the_last_bit(tmp_path: Path, frame: str) -> None:
    with xarray.open_dataset(save_record(_run(), tmp_path, kind="nc", frame=frame)) as read:
        for name, values in _columns(_run(), frame).items():
            np.testing.assert_array_equal(read[name].values, values, err_msg=name)
            assert read[name].attrs["long_name"]
        assert {name: read[name].attrs["units"] for name in UNITS} == UNITS
        assert {read[name].attrs["units"] for name in LOG_THRUST[:3]} == {"N"}
        assert read.attrs["frame"] == FRAME_TEXT[frame]  # type: ignore[index]


@pytest.mark.parametrize("frame", FRAMES)
def test_numpy_reads_the_csv(tmp_path: Path, frame: str) -> None:
    path = save_record(_run(), tmp_path, kind="csv", frame=frame)
    comment, header, *_ = path.read_text(encoding="utf-8").splitlines()
    assert comment.startswith(f"# frame={frame} (") and FRAME_TEXT[frame] in comment  # type: ignore[index]
    read = np.loadtxt(path, delimiter=",", skiprows=2)
    for name, values in _columns(_run(), frame).items():
        np.testing.assert_array_equal(read[:, header.split(",").index(name)], values, err_msg=name)


def test_a_log_is_the_same_log_in_either_frame(tmp_path: Path) -> None:
    r = _run().record
    for frame in FRAMES:
        path = save_record(_run(), tmp_path, kind="csv", frame=frame)
        log = read_motion_log(path)
        np.testing.assert_allclose(log.motion, np.column_stack([r.eta, r.nu]), rtol=0, atol=1e-15)
        np.testing.assert_array_equal(log.thrust, r.tau)  # all that a fit reads: it does not depend on the frame
        np.testing.assert_array_equal(log.time, r.time)
        bare = tmp_path / "bare.csv"
        bare.write_text(path.read_text().partition("\n")[2])
        np.testing.assert_array_equal(read_motion_log(bare, frame=frame).motion, log.motion)
    assert read_motion_log(bare).motion[0, 2] > 0  # unnamed, it counts as enu: then this robot flies


@pytest.mark.parametrize("frame", FRAMES)
def test_a_log_is_the_same_log_in_every_format(tmp_path: Path, frame: str) -> None:
    logs = [read_motion_log(save_record(_run(), tmp_path, kind=kind, frame=frame)) for kind in RECORD_FORMATS]
    for log in logs[1:]:
        for one, other in ((log.time, logs[0].time), (log.motion, logs[0].motion), (log.thrust, logs[0].thrust)):
            assert one.tobytes() == other.tobytes()


def test_arrays_that_are_no_log_are_told_with_file_and_remedy(tmp_path: Path) -> None:
    (tmp_path / "bad.mat").write_bytes(b"no MAT-file" * 20)
    (tmp_path / "bad.nc").write_bytes(b"CDF?")
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    savemat(tmp_path / "text.mat", {"note": "nothing"})
    savemat(tmp_path / "other.mat", {"time": [0.0, 1.0, 2.0], "more": [1.0]})
    for name, message in (
        ("gone.mat", "no such file"),
        ("bad.mat", "cannot be read as a MAT-file"),
        ("bad.nc", "cannot be read as a netCDF file"),
        ("new.mat", "save it with -v7"),
        ("text.mat", "has no numeric vectors"),
        ("other.mat", "column 't_s' is missing"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            read_motion_log(tmp_path / name)
        assert name in str(caught.value) and "\n" not in str(caught.value)


def test_a_frame_other_than_the_file_s_is_refused(tmp_path: Path) -> None:
    path = save_record(_run(), tmp_path, kind="csv", frame="ned")
    with pytest.raises(InputError, match=r"frame = 'enu'.*the file states \(ned\)"):
        read_motion_log(path, frame="enu")
    with pytest.raises(InputError, match="'nwu'"):
        read_motion_log(path, frame="nwu")
    path.write_text(path.read_text().replace("frame=ned", "frame=nwu"))
    with pytest.raises(InputError, match="'nwu'"):
        read_motion_log(path)


def test_a_number_that_is_none_is_written(tmp_path: Path) -> None:
    """Where nothing stands, the clearance is infinite."""
    record = replace(_run().record, clearance=np.full(len(_run().record.time), np.inf))
    odd = replace(_run(), record=record)
    for kind in RECORD_FORMATS:
        save_record(odd, tmp_path, kind=kind)
    assert np.isinf(loadmat(tmp_path / "pool-behind-0.mat")["clearance_m"]).all()
    assert np.isinf(np.loadtxt(tmp_path / "pool-behind-0.csv", delimiter=",", skiprows=2)[:, -2]).all()


def test_mistakes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--save.*'xls'"):
        save_record(_run(), tmp_path, kind="xls")
    with pytest.raises(InputError, match=r"--frame.*'nde'.*ned"):
        record_columns(_run(), frame="nde")
