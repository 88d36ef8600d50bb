"""A sweep of any system: random runs, resume, other processes."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import xarray
from numpy.typing import ArrayLike

from surctl.errors import InputError, SurctlError
from surctl.ir import Layout, Port
from surctl.own_code import pinned
from surctl.system import Controller, Cost, Plant, Sampled, System, simulate_system
from surctl.tuning import (
    ONE_POINT,
    Design,
    LocalExecutor,
    Span,
    SweepTable,
    SystemSweep,
    grid,
    parse_axis,
    random_draws,
    spread,
    sweep,
)
from surctl.tuning.chunked import Chunk, Evaluator, SweepStage, evaluated_chunks
from surctl.tuning.system_sweep import chosen_points, run_at, runs_of
from tests.tools import need_compiler

X, U, Z = Port("x", (1,), "m", "", 1.0), Port("u", (1,), "m/s", ""), Port("z", (1,), "m", "")
NOISY = Path(__file__)


def build(scale: float = 1.0, cost: str = "final") -> System:
    """A cart whose position is measured with noise; `a` scales its command."""
    plant = Plant(
        "cart", Layout((X,)), Layout((U,)), lambda x, f, d, p: {"x": scale * p["a"] * f["u"]},
        parameters=Layout((Port("a", (1,), "1", "", 1.0),)),
    )  # fmt: skip
    law = Controller(
        "hold", 0.1, Layout((Z,)), Layout((U,)), lambda x, u, p: -p["k"] * u["z"],
        gains=Layout((Port("k", (1,), "1/s", "", 2.0),)),
    )  # fmt: skip
    camera = Sampled(
        "camera", Layout((X,)), Layout((Z,)), lambda x, u, p, w: {"z": u["x"] + 0.3 * w["e"]},
        normal=Layout((Port("e", (1,), "1", ""),)),
    )  # fmt: skip
    costs = {cost: Cost(lambda s: ca.fabs(s.x["x"]), "final", "m"), "least": Cost(lambda s: s.x["x"], "min", "m")}
    return System(plant, law, sensors=(camera,), costs=costs, stops={"far": lambda s: s.x["x"] < -0.2})


DESIGN = grid([parse_axis("k=1..5:5")])
DRAWS = {"seed": np.arange(40.0), **random_draws([Span("plant.a", 0.8, 1.2)], count=40)}


def sweep_system(
    system: System, design: Design, seconds: float, *, draws: Mapping[str, ArrayLike] = {}, source: str = "",
    values: Mapping[str, ArrayLike] = {}, **how: Any,
) -> SweepTable:  # fmt: skip
    return sweep(SystemSweep(system, seconds, draws, values, source=source), design, **how)


def alike(first: SweepTable, second: SweepTable) -> bool:
    one, other = (runs_of(table, build()) for table in (first, second))
    pairs = [*zip(one.figures.values(), other.figures.values(), strict=True)]
    pairs += [(one.time, other.time), (one.state, other.state)]
    stopped = one.stopped.tolist() == other.stopped.tolist()
    return stopped and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def test_a_point_is_judged_by_its_worst_run_and_not_by_its_luckiest() -> None:
    need_compiler()
    swept = sweep_system(build(), DESIGN, 3.0, draws=DRAWS)
    points = {"k": np.repeat(DESIGN.points[:, 0], 40), **{name: np.tile(v, 5) for name, v in DRAWS.items()}}
    runs = simulate_system(build(), 3.0, points)
    table = runs["final"].reshape(5, 40)
    np.testing.assert_array_equal(swept.worst("final"), table.max(axis=1))
    np.testing.assert_array_equal(swept.mean("final"), table.mean(axis=1))
    best = swept.best("final")
    assert best == (int(table.max(axis=1).argmin()),) != (int(table.min(axis=1).argmin()),)
    k = chosen_points(swept, build())["final"].run
    assert runs["final"][k] == table[k // 40].max()
    assert run_at(swept, k) == (swept.at((k // 40,)), {name: values[k % 40] for name, values in DRAWS.items()})
    assert {"far", "time"} == set(runs_of(swept, build()).stopped)
    rows = swept.rows()
    assert [row["seed"] for row in rows[:41]] == [*range(40), 0] and [row["k"] for row in rows[39:41]] == [1.0, 2.0]
    assert rows[40]["final"] == runs["final"][40]


def test_a_point_with_a_run_without_a_value_is_never_the_best() -> None:
    need_compiler()
    swept = sweep_system(build(), DESIGN, 3.0, draws={"start.x": [1.0, -1.0], "seed": [0.0, 0.0]})
    assert np.isnan(swept.worst("final")).all() and swept.best("final") is None  # each second run ends at its start
    assert np.isfinite(swept.column("final")[:, 0]).all() and not chosen_points(swept, build())


def test_a_table_of_another_system_is_refused() -> None:
    need_compiler()
    swept = sweep_system(build(), DESIGN, 0.2)
    with pytest.raises(InputError, match="no such column"):
        runs_of(swept, build(cost="last"))


class Few:
    """An executor that stops as Ctrl-C does after some chunks, and counts them."""

    def __init__(self, most: int) -> None:
        self.most, self.count = most, 0

    def map_chunks(self, function: Evaluator, chunks: Iterable[Chunk]) -> Iterator[tuple[int, np.ndarray]]:
        for index, points in chunks:
            if self.count == self.most:
                raise KeyboardInterrupt
            self.count += 1
            yield index, function(index, points)


def test_an_interrupted_sweep_resumes_with_the_same_numbers(tmp_path: Path) -> None:
    need_compiler()
    whole = sweep_system(build(), DESIGN, 3.0, draws=DRAWS, out=tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        sweep_system(build(), DESIGN, 3.0, draws=DRAWS, out=tmp_path / "parts", executor=Few(3))
    other, rest, lines = Few(9), Few(9), list[str]()
    sweep_system(build(), DESIGN, 3.1, draws=DRAWS, out=tmp_path / "parts", executor=other)  # of another request
    assert other.count == 4
    done = sweep_system(build(), DESIGN, 3.0, draws=DRAWS, out=tmp_path / "parts", executor=rest, progress=lines.append)
    assert rest.count == 1 and lines[0] == "sweep 192/200 runs" and "another request" in lines[-1]
    assert alike(done, whole) and not (tmp_path / "parts" / "sweep.chunks").exists()
    again = sweep_system(build(), DESIGN, 3.0, draws=DRAWS, out=tmp_path / "parts", executor=Few(0))
    assert alike(again, whole) and again.path == tmp_path / "parts" / "sweep.nc"
    with xarray.open_dataset(again.path) as read:
        assert read["final"].dims == ("k", "seed") and read["plant.a"].dims == ("seed",)
        np.testing.assert_array_equal(read["final"].values, whole.column("final"))


@pytest.mark.parametrize(
    "change",
    [{"seconds": 3.1}, {"values": {"start.x": 0.9}}, {"draws": {"seed": 1 + np.arange(40.0)}}, {"cost": "end"}],
)
def test_a_change_is_another_request(change: dict[str, object], tmp_path: Path) -> None:
    need_compiler()
    asked = {"seconds": 3.0, "draws": {"seed": np.arange(40.0)}, "out": tmp_path}
    sweep_system(build(), DESIGN, **asked)  # type: ignore[arg-type]
    system = build(cost=str(change.pop("cost", "final")))
    counting = Few(99)
    sweep_system(system, DESIGN, **asked | change, executor=counting)  # type: ignore[arg-type]
    assert counting.count > 0 and len(list(tmp_path.glob("sweep*.nc"))) == 2


def test_other_processes_build_the_system_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    source = tmp_path / "noisy.py"
    source.write_text(NOISY.read_text().split("DESIGN = ")[0])
    ways = {
        source: sweep_system(
            build(), DESIGN, 1.0, draws=DRAWS, source=f"{source}:build", executor=LocalExecutor(2, alone_s=0.0)
        ),
        None: sweep_system(build(), DESIGN, 1.0, draws=DRAWS),
    }
    assert alike(ways[source], ways[None])
    with pytest.raises(InputError, match="known to this process alone; give source"):
        sweep_system(build(), DESIGN, 1.0, draws=DRAWS, executor=LocalExecutor(2, alone_s=0.0))
    with pytest.raises(SurctlError, match=r"noisy\.py:build returns another system"):
        pickle.loads(pickle.dumps(SystemSweep(build(2.0), 1.0, source=f"{source}:build")))
    assert pinned(f"{source}:build", key="source").startswith(str(source))


def test_points_that_fill_ranges_and_random_runs_alone(tmp_path: Path) -> None:
    need_compiler()
    swept = sweep_system(build(), spread("lhs", [Span("k", 1, 3)], count=6), 1.0, out=tmp_path)
    with xarray.open_dataset(tmp_path / "sweep.nc") as read:
        assert read["final"].dims == read["k"].dims == ("point",) and read["k"].units == "1/s"
    assert swept.each == 1 and swept.worst("final").shape == (6,)
    alone = sweep_system(build(), ONE_POINT, 1.0, draws=DRAWS, out=tmp_path)
    with xarray.open_dataset(tmp_path / "sweep.nc") as read:
        assert read["final"].dims == ("seed",) and float(read["final"].max()) == alone.worst("final")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"draws": {"k": [1.0, 2.0]}}, "k: is given twice"),
        ({"draws": {"seed": [0.5, 1.0]}}, "seed = 0.5: is not a seed"),
        ({"draws": {"nothing": [1.0]}}, "nothing: no such number"),
        ({"design": ONE_POINT}, "axis: nothing to sweep"),
        ({"draws": {"seed": np.arange(3e6)}}, "runs = 15000000: are too many"),
        ({"draws": {"seed": [1.0]}, "system": build(cost="seed")}, "seed: is the name of a cost too; rename the cost"),
    ],
)
def test_a_wrong_sweep_is_one_line(change: dict[str, object], text: str) -> None:
    asked = {"system": build(), "design": DESIGN, "seconds": 1.0} | change
    with pytest.raises(InputError, match=text):
        sweep_system(**asked)  # type: ignore[arg-type]


def test_an_error_in_the_file_keeps_the_chunks(tmp_path: Path) -> None:
    def double(index: int, points: np.ndarray) -> np.ndarray:
        return 2 * points

    stage = SweepStage(("x",), np.arange(6.0)[:, None], 2, 1)
    executor, lines = LocalExecutor(), list[str]()
    for writes in (False, True):
        store = evaluated_chunks(
            double, [stage], out=tmp_path, request="r" * 64, executor=executor, progress=lines.append
        )
        if writes:
            with store as columns:
                assert columns(0, 0).tolist() == [0, 2, 4, 6, 8, 10]
            continue
        with pytest.raises(InputError, match=r"full; finished chunks are kept; free it; the same command res"), store:
            raise InputError("full", remedy="free it")
        assert len(list(tmp_path.rglob("*.chunk"))) == 3
    assert "sweep 6/6 points" in lines and not list(tmp_path.rglob("*.chunk"))
