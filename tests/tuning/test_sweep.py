import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from threading import Thread

import netCDF4
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import METRICS, load_scenario
from surctl.marine.tuning import MissionSweep, build_cases, picked_gains
from surctl.marine.tuning.sweep import judged
from surctl.store import ChunkStore, one_at_a_time
from surctl.tuning import (
    Axis,
    LocalExecutor,
    Span,
    grid,
    load_sweep,
    make_design,
    parse_axis,
    saltelli,
    sobol_indices,
    spread,
)
from surctl.tuning import sweep as sweep_any
from surctl.tuning.chunked import DaskExecutor, run_chunks
from surctl.verification.linear import LEAST_DISK_MARGIN
from tests.processes import run_python
from tests.tools import PATIENCE
from tests.tuning import stub
from tests.tuning.chunk_work import CHUNKS, own_number, slow_squares, slow_to_start

ROOT = Path(__file__).parents[2]
measured = stub.SWEEP
GRID = grid([Axis("k_v", (0.5, 1.0, 2.0)), Axis("lookahead", (0.6, 1.0))])


@pytest.fixture
def cheap(monkeypatch):
    stub.install(monkeypatch)


def sweep(cases, design, *, seeds=(0,), linear=True, cruise=(), **how):
    return sweep_any(MissionSweep(tuple(cases), tuple(seeds), linear, cruise), design, **how)


def data(table):
    """Digest of the data: every variable's bytes, by name."""
    return {
        name: hashlib.sha256(table.values(name, ...).tobytes()).hexdigest() for name in table.about if name != "case"
    }


# --- axes and designs


@pytest.mark.parametrize(
    ("text", "axis"),
    [
        ("k_v=1,1.5,2", Axis("k_v", (1.0, 1.5, 2.0))),
        ("k_v=2", Axis("k_v", (2.0,))),
        ("k_v=0.5..3:6", Axis("k_v", (0.5, 1.0, 1.5, 2.0, 2.5, 3.0))),
        ("k_v=1..4:3:log", Axis("k_v", (1.0, 2.0, 4.0))),
        ("k_v=0.5..3", Span("k_v", 0.5, 3.0)),
        ("vehicle.m11=1e1..1e2:log", Span("vehicle.m11", 10.0, 100.0, log=True)),
        ("seed=0..4:5", Axis("seed", (0, 1, 2, 3, 4))),
    ],
)
def test_an_axis_is_read(text, axis):
    assert parse_axis(text) == axis


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("k_v", "k_v.*PARAMETER="),
        ("k_v=", "PARAMETER="),
        ("=1,2", "PARAMETER="),
        ("k_v=1,x", "PARAMETER="),
        ("k_v=1..2:3:4", "PARAMETER="),
        ("k_v=1..2:x", "PARAMETER="),
        ("k_v=1..2:0", "two points"),
        ("k_v=1..2:-3", "two points"),
        ("k_v=2,1", "ascending"),
        ("k_v=1,1", "ascending"),
        ("k_v=nan,1", "finite"),
        ("k_v=1,inf", "finite"),
        ("k_v=nan..1", "finite"),
        ("k_v=3..1", "reversed"),
        ("k_v=1..1", "empty"),
        ("k_v=0..1:log", "logarithm"),
        ("seed=-1,2", "whole"),
        ("seed=0..1:3", "whole"),
    ],
)
def test_an_axis_that_is_none_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        parse_axis(text)


@given(st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_a_grid_is_every_combination_in_c_order(lengths):
    names = ("k_v", "k_r", "k1", "k2")
    made = grid([Axis(n, tuple(range(1, k + 1))) for n, k in zip(names, lengths, strict=False)])
    expected = np.array([[v + 1 for v in index] for index in np.ndindex(*lengths)])
    assert made.shape == tuple(lengths)
    assert np.array_equal(made.points, expected)


@pytest.mark.parametrize("kind", ["lhs", "sobol"])
def test_a_filling_design_fills_and_repeats(kind):
    spans = [Span("k_v", 1.0, 3.0), Span("k_r", 0.1, 10.0, log=True), Span("seed", 0, 3)]
    made = spread(kind, spans, count=48, seed=5)
    assert made.points.shape == (48, 3)
    assert np.array_equal(made.points, spread(kind, spans, count=48, seed=5).points)
    assert not np.array_equal(made.points, spread(kind, spans, count=48, seed=6).points)
    assert made.points[:, 0].min() >= 1.0 and made.points[:, 0].max() <= 3.0
    shares = (np.log(made.points[:, 1]) - np.log(0.1)) / np.log(100)
    assert np.all(np.abs(np.histogram(shares, 4, (0, 1))[0] - 12) <= 3)  # even in the logarithm
    assert sorted(set(made.points[:, 2])) == [0, 1, 2, 3]


def test_saltelli_crosses_one_axis_at_a_time():
    made = saltelli([Span("k_v", 1, 2), Span("k_r", 1, 2), Span("k1", 1, 2)], base=8)
    a, b, *crossed = made.points.reshape(5, 8, 3)
    for k, points in enumerate(crossed):
        assert np.array_equal(points[:, k], b[:, k])
        assert np.array_equal(np.delete(points, k, axis=1), np.delete(a, k, axis=1))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: make_design("grid", [Axis("k_v", (1, 2)), Axis("k_v", (1, 2))]), "twice"),
        (lambda: make_design("grid", []), "nothing to sweep"),
        (lambda: make_design("grid", [Span("k_v", 1, 2)]), "k_v=1..2:COUNT"),
        (lambda: make_design("grid", [Axis("k_v", (1, 2))], count=3), "lhs and sobol"),
        (lambda: make_design("lhs", [Span("k_v", 1, 2)]), "--points"),
        (lambda: make_design("lhs", [Span("k_v", 1, 2)], count=0), "at least 1"),
        (lambda: make_design("lhs", [Axis("k_v", (1, 2))], count=3), "LOW..HIGH"),
        (lambda: make_design("lsh", [Span("k_v", 1, 2)], count=3), "lhs"),
        (lambda: saltelli([Span("k_v", 1, 2), Span("k_r", 1, 2)], base=48), "power of two.*64"),
        (lambda: saltelli([Span("k_v", 1, 2)], base=64), "two axes"),
        (lambda: LocalExecutor(0), "at least 1"),
    ],
)
def test_mistakes_in_a_design_are_named(make, words):
    with pytest.raises(InputError, match=words):
        make()


# --- the request


@pytest.mark.parametrize(
    ("axes", "more", "words"),
    [
        ([Axis("kv", (1, 2))], {}, "kv.*k_v"),
        ([Axis("vehicle.m12", (1, 2))], {}, "vehicle.m11|vehicle.m22"),
        ([Axis("vehicle.mass", (1, 2))], {}, "the masses are vehicle.m11, vehicle.m22, vehicle.m33"),
        ([Axis("k_v", (0, 2))], {}, "k_v.*greater than 0"),
        ([Axis("beta_max", (0.1, 0.9))], {}, "beta_max.*at most 0.5"),
        ([Axis("k_v", (1, 2))], {"seeds": ()}, "seeds"),
        ([Axis("k_v", (1, 2))], {"seeds": (0, 0)}, "seeds"),
        ([Axis("k_v", (1, 2))], {"seeds": (-1,)}, "seeds"),
        ([Axis("seed", (1, 2))], {"seeds": (0, 1)}, "already"),
        ([Axis("k_v", (1, 2))], {"cases": ()}, "nothing to simulate"),
        ([Axis("k_v", (1, 2))], {"cases": ("pool-behind", "pool-behind")}, "twice"),
    ],
)
def test_a_request_that_cannot_be_flown_is_named(cheap, axes, more, words):
    cases = [stub.case(name) for name in more.pop("cases", ("pool-behind",))]
    with pytest.raises(InputError, match=words):
        sweep(cases, grid(axes), **more)


def test_an_axis_that_only_one_case_knows_is_for_that_case(cheap, monkeypatch):
    seen = {}

    def fly(case, values, *, seeds):
        seen[case.name] = set(values)
        return stub.fly(case, values, seeds=seeds)

    monkeypatch.setattr(measured, "simulate_batch", fly)
    cases = [stub.case("tank-speed-015"), stub.case("tank-static")]
    names = [set(measured.case_parameters(c)) for c in cases]
    (own,) = [n for n in names[0] - names[1] if n.endswith(".speed")]
    sweep(cases, grid([Axis(own, (0.1, 0.2))]))
    assert [own in seen[c.name] for c in cases] == [True, False]


# --- the table


def test_columns_are_what_the_batch_measures(cheap, tmp_path):
    cases = [stub.case("pool-behind", "sonar"), stub.case("pool-static", "sonar")]
    table = sweep(cases, GRID, seeds=(0, 1, 2), out=tmp_path)
    k_v, lookahead = np.meshgrid([0.5, 1.0, 2.0], [0.6, 1.0], indexing="ij")
    runs = [
        stub.figures(k_v, lookahead, 50.0, np.full((3, 2), float(s)), len(c.scenario.name) / 100)
        for c in cases
        for s in (0, 1, 2)
    ]
    for name, spec in METRICS.items():
        if spec.better is None:
            assert name not in table.columns
            continue
        values = np.stack([run[name] for run in runs])
        mean, worst = np.nanmean(values, 0), (np.nanmax if spec.better == "low" else np.nanmin)(values, 0)
        np.testing.assert_allclose(table.column(name), mean, rtol=1e-14)
        np.testing.assert_array_equal(table.column(f"{name}_worst"), worst)
        one = np.nanmean(values[3:], 0)
        np.testing.assert_allclose(table.column(name, case="pool-static/sur400/sonar"), one, rtol=1e-14)
        assert table.units[name] == spec.unit
    np.testing.assert_allclose(table.column("strayed"), table.column("deviation_m") / cases[0].vehicle["radius"])
    place = list(measured.LINEAR_METRICS).index("delay_margin_s")
    assert np.array_equal(table.column("delay_margin_s"), 1 / k_v + place)
    with pytest.raises(InputError, match="score"):
        table.column("scor")
    with pytest.raises(InputError, match="pool-static"):
        table.column("time_s", case="pool-statik")


def test_a_run_that_went_wrong_shows(cheap, monkeypatch):
    def fly(case, values, *, seeds):
        done = stub.fly(case, values, seeds=seeds)
        done.columns["deviation_m"][0] = np.nan
        done.columns["path_error_m"][:] = np.nan
        return done

    monkeypatch.setattr(measured, "simulate_batch", fly)
    table = sweep([stub.case()], grid([Axis("k_v", (1, 2))]), linear=False)
    assert np.isnan(table.column("deviation_m")).any() and np.isnan(table.column("deviation_m_worst")).any()
    assert np.isnan(table.column("path_error_m")).all()


def test_linear_metrics_once_for_each_combination_that_matters(cheap):
    axes = [Axis("k_v", (1, 2)), Axis("margin", (0.1, 0.2, 0.3)), Axis("seed", (0, 1, 2, 3))]
    table = sweep([stub.case()], grid(axes))
    assert stub.CALLS == [2]  # together
    assert np.array_equal(
        table.column("disk_margin")[:, 1, 2],
        1 / np.array([1.0, 2.0]) + list(measured.LINEAR_METRICS).index("disk_margin"),
    )


def test_the_file_says_what_it_holds(cheap, tmp_path):
    made = sweep([stub.case()], GRID, out=tmp_path)
    table = load_sweep(tmp_path / "sweep.nc")
    assert table.attributes["Conventions"].startswith("CF-")
    assert json.loads(table.attributes["axes"]) == ["k_v", "lookahead"]
    for name, (unit, meaning, _) in table.about.items():
        assert (unit or name == "case") and meaning
    assert data(table) == data(made)
    assert picked_gains(table).name == f"{stub.GAINS.name}-picked"
    assert {axis.name: axis.unit for axis in table.axes} == {"k_v": "1/s", "lookahead": "m"}
    assert not (tmp_path / "sweep.chunks").exists()
    for rubbish in ("no.nc", "text.nc"):
        (tmp_path / "text.nc").write_text("rubbish")
        with pytest.raises(InputError, match=rubbish):
            load_sweep(tmp_path / rubbish)


def test_points_that_fill_have_one_dimension(cheap, tmp_path):
    design = spread("sobol", [Span("k_v", 1, 3), Span("vehicle.m11", 40, 60)], count=10)
    table = sweep([stub.case()], design, out=tmp_path)
    assert table.shape == (10,) and table.column("score").shape == (10,)
    assert np.array_equal(np.stack([axis.values for axis in table.axes], axis=1), design.points)
    picked = table.picked
    assert picked is not None and picked_gains(table)["k_v"] == table.at(picked)["k_v"]
    assert "vehicle.m11" in picked_gains(table).provenance


def test_the_least_score_among_the_feasible_is_picked(cheap):
    table = sweep([stub.case()], GRID, linear=False)
    score = np.where(table.column("feasible") > 0.5, table.column("score"), np.inf)
    assert not table.column("feasible")[0].any()  # k_v = 0.5 does not arrive
    assert table.column("score")[table.picked] == score.min()
    assert picked_gains(table)["k_v"] == table.at(table.picked)["k_v"]
    assert "picked by a grid sweep" in picked_gains(table).provenance
    nothing = sweep([stub.case()], grid([Axis("k_v", (0.2, 0.3))]), linear=False)
    assert nothing.picked is None and picked_gains(nothing) == stub.GAINS
    assert picked_gains(table).name == f"{stub.GAINS.name}-picked"


def test_feasible_takes_arrival_clearance_and_margins():
    ones = {n: np.ones(5) for n in ("strayed", "time_ratio", "delay_margin_s")}
    columns = ones | {
        "reached_worst": np.array([1, 0, 1, 1, 1]),
        "min_clearance_m_worst": np.array([0.1, 0.1, 0.0, 0.1, 0.1]),
        "disk_margin": np.array([LEAST_DISK_MARGIN, 1, 1, np.nextafter(LEAST_DISK_MARGIN, 0), np.nan]),
    }
    assert judged(columns)["feasible"].tolist() == [1, 0, 0, 0, 0]


# --- chunks


def kept(folder):
    return ChunkStore(folder, "request")


def test_a_harmed_or_foreign_chunk_is_not_trusted(tmp_path):
    shelf = kept(tmp_path)
    with shelf.open():
        shelf.write(3, np.arange(6.0).reshape(3, 2))
        assert shelf.has(3, (3, 2)) and not shelf.has(3, (2, 3)) and not shelf.has(2, (3, 2))
        assert shelf.column(3, (3, 2), 1).tolist() == [1.0, 3.0, 5.0]
        assert not ChunkStore(tmp_path, "other").has(3, (3, 2))
        file = next(tmp_path.glob("*.chunk"))
        good = file.read_bytes()
        other = good.replace(b" 3 ", b" 4 ", 1)
        for bad in (b"", good[:-1], good + b"\0", good[:-3] + b"abc", good[10:], b"\n", other):
            file.write_bytes(bad)
            assert not shelf.has(3, (3, 2)), bad
        file.write_bytes(good)
        assert shelf.has(3, (3, 2))
        with pytest.raises(InputError, match="another process"), kept(tmp_path).open():
            pass


def test_two_sweeps_that_end_in_one_folder_keep_both_tables(cheap, tmp_path):
    told, other = [], tmp_path / "sweep.nc"
    ends = Thread(target=sweep, args=([stub.case()], GRID), kwargs={"out": tmp_path, "progress": told.append})
    with one_at_a_time(tmp_path):
        ends.start()
        give_up = time.monotonic() + PATIENCE
        while not any(line.startswith("sweep 6/6") for line in told) and time.monotonic() < give_up:
            time.sleep(0.01)
        time.sleep(0.2)  # the sweep would write its table in this time
        assert not other.exists()
        other.write_bytes(b"another table")
    ends.join()
    assert load_sweep(other).shape == (3, 2)
    assert (tmp_path / "sweep-unreadable.nc").read_bytes() == b"another table"


def test_files_that_are_no_tables_are_all_kept(cheap, tmp_path):
    for number in range(2):
        (tmp_path / "sweep.nc").write_text(f"{number}")
        sweep([stub.case()], grid([Axis("k_v", (1.0 + number,))]), out=tmp_path)
    assert [(tmp_path / f"sweep-unreadable{k}.nc").read_text() for k in ("", 1)] == ["0", "1"]


def test_a_table_without_its_axes_is_none(cheap, tmp_path):
    sweep([stub.case()], GRID, out=tmp_path)
    for wrong in ("k_v", '["k_v", "no_such"]', "7"):
        with netCDF4.Dataset(tmp_path / "sweep.nc", "a") as file:
            file.setncattr("axes", wrong)
        with pytest.raises(InputError, match=r"sweep\.nc: is not the table of a sweep"):
            load_sweep(tmp_path / "sweep.nc")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_loop_beyond_the_largest_double_is_one_line():
    with pytest.raises(InputError, match="changes too fast for floating-point numbers"):
        sweep([stub.case()], grid([Axis("plant.m11", (1e-308,))]))


def test_a_harmed_chunk_alone_is_run_again(cheap, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("netCDF4.Dataset", full)
        with pytest.raises(InputError, match=r"No space left on device.*kept.*resumes"):
            sweep([stub.case()], GRID, out=tmp_path)
    files = sorted(tmp_path.glob("sweep.chunks/*/*.chunk"))
    files[-1].write_bytes(files[-1].read_bytes()[:-1])
    told = []
    table = sweep([stub.case()], GRID, out=tmp_path, progress=told.append)
    assert told[0].startswith("sweep 5/6 points")
    assert data(table) == data(sweep([stub.case()], GRID))


def test_another_request_in_the_folder_keeps_the_first_one_s_table(cheap, tmp_path):
    first, told = sweep([stub.case()], GRID, out=tmp_path), []
    before = data(first)
    sweep([stub.case()], GRID, seeds=(1,), out=tmp_path, progress=told.append)  # pool-behind has no seed in it
    assert any("another request" in line for line in told)
    told.clear()
    again = sweep([stub.case()], GRID, out=tmp_path, progress=told.append)
    assert len(told) == 1 and "has all points" in told[0] and again.path.name != "sweep.nc"
    assert data(again) == before


def test_a_harmed_table_is_made_again(cheap, tmp_path):
    made = data(sweep([stub.case()], GRID, out=tmp_path))
    file = tmp_path / "sweep.nc"
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 2 : len(raw) // 2 + 4000] = b"\xff" * 4000
    file.write_bytes(raw)
    told = []
    again = sweep([stub.case()], GRID, out=tmp_path, progress=told.append)
    assert "has all points" not in told[0]
    assert data(again) == made


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("SURCTL_TEST_TRACE", str(tmp_path / "trace"))
    synced, real = [], os.fsync

    def fsync(handle):
        synced.append(handle)
        if len(synced) > 20:  # a file and its folder for each chunk
            raise OSError(28, "No space left on device")
        real(handle)

    shelf = kept(tmp_path / "chunks")
    with monkeypatch.context() as patch, shelf.open():
        patch.setattr("surctl.store.os.fsync", fsync)
        with pytest.raises(InputError, match="No space left on device") as caught:
            run_chunks(slow_squares, CHUNKS, store=shelf, executor=LocalExecutor())
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "chunks").glob("*.tmp"))
    assert [shelf.has(k, (3, 2)) for k, _ in CHUNKS] == [k < 10 for k in range(40)]


def test_a_limit_on_file_size_is_one_line_too(tmp_path):
    shelf = kept(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with shelf.open():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
        try:
            with pytest.raises(InputError, match="cannot be written"):
                shelf.write(0, np.zeros((1000, 2)))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.glob("*.tmp")) and not shelf.has(0, (1000, 2))


KILLED = """
import os, random, signal, sys, time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from surctl.tuning.chunked import LocalExecutor
from surctl.store import ChunkStore
from surctl.tuning.chunked import run_chunks
from tests.tuning.chunk_work import CHUNKS, slow_squares

shelf, draw = ChunkStore(Path(sys.argv[1]), "request"), random.Random(int(sys.argv[2]))


def fly():
    with shelf.open():
        todo = [(k, p) for k, p in CHUNKS if not shelf.has(k, (3, 2))]
        run_chunks(slow_squares, todo, store=shelf, executor=LocalExecutor())


for _ in range(20):
    child = os.fork()
    if child == 0:
        fly()
        os._exit(0)
    time.sleep(draw.uniform(0.0, 0.03))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
fly()
"""


def test_killed_twenty_times_it_is_the_same_to_the_byte(tmp_path, monkeypatch):
    (tmp_path / "script.py").write_text(KILLED)
    environment = os.environ | {"SURCTL_TEST_TRACE": str(tmp_path / "trace")}
    done = run_python([str(tmp_path / "script.py"), str(tmp_path / "killed"), "7"], environment=environment)
    assert done.returncode == 0, done.stderr
    runs = [int(line) for line in (tmp_path / "trace").read_text().split()]
    assert set(runs) == set(range(40))
    assert len(runs) <= 40 + 20  # a kill costs the chunk in flight and no other
    monkeypatch.setenv("SURCTL_TEST_TRACE", str(tmp_path / "other"))
    shelf = kept(tmp_path / "whole")
    with shelf.open():
        run_chunks(slow_squares, CHUNKS, store=shelf, executor=LocalExecutor())
    for path in sorted((tmp_path / "whole").glob("*.chunk")):
        assert path.read_bytes() == (tmp_path / "killed" / path.name).read_bytes()
    assert not list((tmp_path / "killed").glob("*.tmp"))


LEFT = """
import os, signal, sys
import numpy as np
from surctl.tuning.chunked import LocalExecutor
from tests.tuning.chunk_work import own_number

if __name__ == "__main__":
    done = LocalExecutor(2, alone_s=0.0).map_chunks(own_number, [(k, np.ones((1, 1))) for k in range(10_000)])
    print(int(next(done)[1][0, 0]), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_every_case_weighs_the_same_in_a_mean(cheap):
    cases = [stub.case("tank-static"), stub.case("pool-static")]
    table = sweep(cases, GRID, seeds=(0, 1, 2), linear=False)
    for name in ("deviation_m", "effort_n"):
        by_case = np.stack([table.column(name, case=c.name) for c in cases])
        np.testing.assert_allclose(table.column(name), by_case.mean(axis=0), rtol=1e-14)


def test_workers_do_not_outlive_who_asked_for_them(tmp_path):
    script = tmp_path / "left.py"
    script.write_text(LEFT)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (tmp_path / "told").open("w") as told:
        done = subprocess.run(
            [sys.executable, str(script)], env=environment, cwd=ROOT, stdout=told, stderr=told, timeout=PATIENCE,
        )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, (tmp_path / "told").read_text()
    worker = int((tmp_path / "told").read_text().split()[0])
    deadline = time.monotonic() + PATIENCE
    while Path(f"/proc/{worker}").exists() and "\nState:\tZ" not in Path(f"/proc/{worker}/status").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_workers_are_started_for_long_work_alone_and_give_the_same():
    chunks = CHUNKS[:6]
    short = dict(LocalExecutor(2, alone_s=60.0).map_chunks(own_number, chunks))
    assert {int(found[0, 0]) for found in short.values()} == {os.getpid()}
    long = dict(LocalExecutor(2, alone_s=0.015).map_chunks(own_number, chunks))
    own = [k for k, found in long.items() if int(found[0, 0]) == os.getpid()]
    assert sorted(long) == list(range(6)) and own == [0, 1]  # at least 10 ms each
    assert all(np.array_equal(short[k][:, 1], long[k][:, 1]) for k in short)


def test_a_slow_first_chunk_starts_no_workers():
    done = LocalExecutor(2, alone_s=1.0).map_chunks(slow_to_start, CHUNKS[:6])
    assert {int(row[0, 0]) for _, row in done} == {os.getpid()}


def test_a_case_that_no_seed_changes_is_flown_once():
    cases = (stub.case("tank-static"), stub.case("pool-static"), stub.case("tank-static", "sonar"))
    flown = MissionSweep(cases, (0, 1, 2))
    assert [len(flown.seeds_of(case, ("k_v", "plant.m11"))) for case in cases] == [1, 3, 3]
    assert flown.runs_per_point(("scenario.wave_force",)) == 9


# --- sensitivity


def test_indices_of_a_known_function(cheap, monkeypatch):
    """Ishigami's function with a = 7, b = 0.1 has closed-form indices."""

    one = stub.case("pool-static")
    third = next(n for n in measured.case_parameters(one) if n.startswith("obstacle.") and n.endswith(".x"))
    names = ("scenario.current_x", "scenario.current_y", third)

    def fly(case, values, *, seeds):
        done = stub.fly(case, {}, seeds=seeds)
        x, y, z = (values.get(n, np.zeros_like(done.columns["length_m"])) for n in names)
        done.columns["deviation_m"] = np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
        return done

    monkeypatch.setattr(measured, "simulate_batch", fly)
    design = saltelli([Span(n, -np.pi, np.pi) for n in names], base=1024)
    table = sweep([one], design, linear=False)
    found = sobol_indices(design, table.column("deviation_m"), "deviation_m")
    np.testing.assert_allclose(found.first, (0.3139, 0.4424, 0.0), atol=0.03)
    np.testing.assert_allclose(found.total, (0.5576, 0.4424, 0.2437), atol=0.03)
    for value, (low, high) in zip(found.first + found.total, found.first_interval + found.total_interval, strict=True):
        assert low <= value <= high and high - low < 0.25
    assert found == sobol_indices(design, table.column("deviation_m"), "deviation_m")
    constant = sobol_indices(design, table.column("length_m"), "length_m")
    assert constant.constant and set(constant.total) == {0.0}
    with pytest.raises(InputError, match="Saltelli"):
        sobol_indices(GRID, np.zeros(6), "deviation_m")


def test_intervals_of_indices_contain_the_true_ones():
    # linear functions with one interaction have indices in closed form
    rng, inside = np.random.default_rng(5), []
    names = ("k_v", "k_r", "k_psi")
    for seed in range(12):
        slopes, both = rng.uniform(0.2, 2.0, 3), rng.uniform(0.0, 3.0)
        design = saltelli([Span(name, 0.0, 1.0) for name in names], base=64, seed=seed)
        x = design.points
        values = x @ slopes + both * (x[:, 0] - 0.5) * (x[:, 1] - 0.5)
        alone, shared = slopes**2 / 12, both**2 / 144
        truth = np.array([alone, alone + shared * np.array([1, 1, 0])]) / (alone.sum() + shared)
        result = sobol_indices(design, values, "y")
        ends = np.array([result.first_interval, result.total_interval])
        inside += ((ends[..., 0] <= truth) & (truth <= ends[..., 1])).ravel().tolist()
        assert not result.warning and "8 points" in replace(result, base=8).warning
    assert np.mean(inside) >= 0.95


def test_a_column_that_lacks_numbers_has_no_indices(cheap):
    design = saltelli([Span("k_v", 1, 2), Span("seed", 0, 9)], base=8)
    with pytest.raises(InputError, match="not a finite number at"):
        sobol_indices(design, sweep([stub.case()], design, linear=False).column("path_error_m"), "path_error_m")


def test_a_silent_scheduler_is_told_soon():
    with pytest.raises(InputError, match="no scheduler replies") as caught:
        list(DaskExecutor("tcp://127.0.0.1:9").map_chunks(slow_squares, CHUNKS))
    assert "\n" not in str(caught.value)


# --- guidance


def test_guidance_is_part_of_a_case_and_of_the_request_that_a_folder_keeps():
    scenario, gains = load_scenario("pool-behind"), load_gains("default")
    los, ilos = (build_cases([scenario], gains=gains, guidance=name) for name in ("los", "ilos"))
    assert (los[0].guidance, ilos[0].guidance) == ("los", "ilos")
    assert measured.law_digest(los[0]) != measured.law_digest(ilos[0])
    with pytest.raises(InputError, match="did you mean 'ilos'"):
        build_cases([scenario], gains=gains, guidance="ilo")
