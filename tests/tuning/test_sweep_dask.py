"""A cluster in this process; one of processes, one of which is killed, is a check of `analysis/40_long_checks`."""

from __future__ import annotations

import pytest

from surctl.tuning import DaskExecutor, LocalExecutor
from tests.tools import need_module
from tests.tuning.chunk_work import CHUNKS, slow_squares


def test_a_cluster_gives_what_this_machine_gives(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_module("distributed")
    from distributed import LocalCluster

    monkeypatch.setenv("SURCTL_TEST_TRACE", str(tmp_path / "trace"))
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        found = dict(DaskExecutor(cluster.scheduler_address).map_chunks(slow_squares, CHUNKS[:4]))
    local = dict(LocalExecutor().map_chunks(slow_squares, CHUNKS[:4]))
    assert sorted(found) == sorted(local) and all(found[k].tobytes() == local[k].tobytes() for k in local)
