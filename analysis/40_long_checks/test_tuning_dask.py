"""A real scheduler and two workers, one of which is killed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.tuning import DaskExecutor, LocalExecutor
from tests.tools import PATIENCE, need_module
from tests.tuning import chunk_work
from tests.tuning.chunk_work import slow_squares

ROOT = Path(__file__).parents[2]
CHUNKS = chunk_work.CHUNKS[:16]


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    monkeypatch.setenv("SURCTL_TEST_TRACE", str(tmp_path / "trace"))
    monkeypatch.setenv("SURCTL_TEST_PAUSE", "0.1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    begun = []

    def begin(*words):
        log = (tmp_path / f"{len(begun)}.log").open("w")
        with log:
            begun.append(subprocess.Popen([sys.executable, "-m", "distributed.cli." + words[0], *words[1:]],
                                          stdout=log, stderr=log, cwd=tmp_path, start_new_session=True))  # fmt: skip
        return begun[-1]

    told = tmp_path / "scheduler.json"
    begin("dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(told))
    wait(told.exists)
    address = json.loads(told.read_text())["address"]
    try:
        yield address, begin
    finally:
        for process in begun:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_killed_worker_changes_nothing(cluster, tmp_path):
    need_module("distributed")
    import distributed

    address, begin = cluster
    with pytest.raises(InputError, match="no worker"):
        list(DaskExecutor(address).map_chunks(slow_squares, CHUNKS))
    workers = [begin("dask_worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard") for _ in range(2)]
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
    found = {}
    for index, result in DaskExecutor(address).map_chunks(slow_squares, CHUNKS):
        found[index] = result
        if len(found) == 3:
            os.kill(workers[0].pid, signal.SIGKILL)
    assert workers[0].wait() == -signal.SIGKILL
    local = dict(LocalExecutor().map_chunks(slow_squares, CHUNKS))
    assert sorted(found) == sorted(local)
    assert all(found[k].tobytes() == local[k].tobytes() for k in local)
