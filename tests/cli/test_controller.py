"""`surctl simulate --controller` and `surctl check --bundle` as processes, with a controller that is one, too."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from surctl.export import write_bundle
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form
from surctl.marine.export.origin import Origin
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle
from tests.cli.process import LIBRARY, surctl, surctl_here
from tests.processes import Running
from tests.tools import need_compiler

SCENARIO, LAW = "pool-behind", "closed_form"
LOSSY = ("--link-loss", "0.2")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exported law of the scenario, its process compiled."""
    need_compiler()
    folder = tmp_path_factory.mktemp("exported") / "bundle"
    mission, law = load_scenario(SCENARIO), build_law(LAW)
    vehicle = load_vehicle(mission.vehicle)
    p = law_numbers(mission, load_gains("default"), vehicle)
    made = build_bundle(
        closed_form(law, real="float32"), law.gains.unpack(p), real="float32", origin=Origin(vehicle, law)
    )
    write_bundle(made, folder)
    sources = [folder / file for file in ("controller.c", "link.c", *made.sources)]
    compile_program(sources, folder / "controller", flags=("-O0",))
    return folder


@contextmanager
def controller(bundle: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The process and its port."""
    process = subprocess.Popen([str(bundle / "controller"), "0"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process, int(process.stdout.readline().rsplit(":", 1)[1])
    finally:
        process.kill()
        process.communicate()


@contextmanager
def between(port: int, *, after: int, then: Callable[[socket.socket], object]) -> Iterator[int]:
    """A port that hands questions on to the controller; `then` is done to the robot's end before the next one."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def carry() -> None:
            robot, _ = server.accept()
            with robot, socket.create_connection(("127.0.0.1", port)) as line:
                for _ in range(after):
                    line.sendall(robot.recv(65536))  # a question is one packet, its answer a few
                    answer = line.recv(16, socket.MSG_WAITALL)
                    length = int.from_bytes(answer[12:16], "little")
                    robot.sendall(answer + (line.recv(length, socket.MSG_WAITALL) if length else b""))
                then(robot)

        thread = threading.Thread(target=carry, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        thread.join(60)


def test_a_scenario_flies_through_a_process_and_the_line_may_be_bad(bundle: Path, tmp_path: Path) -> None:
    with controller(bundle) as (_, port):
        address = ("--controller", f"tcp://127.0.0.1:{port}")
        done = surctl("simulate", SCENARIO, "--law", LAW, *address, "--json", cwd=tmp_path)
        (run,) = done.json["runs"]
        assert done.status == 0 and run["reached"]
        link = run["link"]
        assert (link["real"], link["differing"], link["failsafe_steps"], link["gone_s"]) == ("float32", 0, 0, None)
        assert link["answered"] == link["steps"] > 200
        bad = surctl("simulate", SCENARIO, "--law", LAW, *address, *LOSSY, "--json", cwd=tmp_path)
        (run,) = bad.json["runs"]
        assert run["link"]["lost_requests"] > 20 and run["link"]["differing"] == 0
        other = surctl("simulate", "pool-ahead", "--law", LAW, *address, cwd=tmp_path)
        assert other.status == 2 and "runs controller" in other.complaint and "same scenario" in other.complaint


def test_a_controller_that_dies_or_falls_silent_is_reported(bundle: Path, tmp_path: Path) -> None:
    for then, told in (("kill", "closed the connection"), ("wait", "was silent for 3 s")):
        with controller(bundle) as (process, port):

            def end(robot: socket.socket, process: subprocess.Popen[str] = process, then: str = then) -> None:
                process.kill()
                if then == "wait":
                    robot.settimeout(30)
                    while robot.recv(65536):
                        pass

            with between(port, after=42, then=end) as relay:
                words = ("--controller", f"tcp://127.0.0.1:{relay}", "--link-timeout", "3", "--runs", "3", "--json")
                done = surctl("simulate", SCENARIO, "--law", LAW, *words, cwd=tmp_path)
        (run,) = done.json["runs"]  # the runs after it are not flown
        # it drifts, and what comes from behind runs into it
        assert done.status == 1 and run["stopped_because"] == "collision" and not run["reached"]
        assert run["link"]["gone_s"] == 2.0 and told in run["link"]["gone_because"]
        assert run["link"]["answered"] == 40 and run["link"]["differing"] == 0
        assert "Traceback" not in done.err


def test_ctrl_c_ends_a_flight_in_one_line(bundle: Path, tmp_path: Path) -> None:
    begun, over = threading.Event(), threading.Event()

    def wait(_: socket.socket) -> None:
        begun.set()
        over.wait(60)

    with controller(bundle) as (_, port), between(port, after=10, then=wait) as relay:
        words = ["simulate", SCENARIO, "--law", LAW, "--controller", f"tcp://127.0.0.1:{relay}", "--link-timeout", "60"]
        with Running(["-m", "surctl", *words], cwd=LIBRARY.parent) as flight:
            flight.until(begun.is_set)
            flight.send(signal.SIGINT)
            status, out, err = flight.wait(), flight.out, flight.err
        over.set()
    assert status == 130 and out.startswith("vehicle ") and out.count("\n") == 1
    assert err.strip() == "surctl: stopped; the run was not finished"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--controller", "tcp://127.0.0.1:9"), "no controller listens there"),
        (("--controller", "tcp://[::1]:9"), "no controller listens there"),
        (("--controller", "udp://127.0.0.1:9"), "is not the address of a controller"),
        (("--controller", "qemu:cortex-m99"), "is not an emulated processor"),
        (("--controller", "tcp://127.0.0.1:9", "--link-loss", "2"), "is not a probability"),
        (("--controller", "tcp://127.0.0.1:9", "--link-delay", "-1"), "is not a valid time"),
        (("--link-loss", "0.1"), "needs a controller over a link"),
        (("--controller", "tcp://127.0.0.1:9", "--monte-carlo"), "applies only to single runs"),
        (("--controller", "tcp://127.0.0.1:9", "--from", "run.toml"), "applies only to single runs"),
    ],
)
def test_mistakes_are_told_in_one_line(words: tuple[str, ...], told: str, tmp_path: Path) -> None:
    done = surctl_here("simulate", SCENARIO, "--law", LAW, *words, cwd=tmp_path)
    assert done.status == 2 and told in done.complaint


def test_check_tells_whether_a_certificate_is_about_a_bundle(bundle: Path, tmp_path: Path) -> None:
    proved = surctl("verify", "v1-corrected", "--out", "proofs", cwd=tmp_path)
    assert (
        proved.status == 1 and "ok   v1-corrected           proved" in proved.out
    )  # the default gains miss the margin
    done = surctl("check", "proofs/v1-corrected.json", "--bundle", bundle, cwd=tmp_path)
    assert done.status == 0 and "belongs to the controller" in done.out and "not covered: dynamics" in done.out
    manifest = json.loads((bundle / "manifest.json").read_text())
    manifest["claims"]["v1-corrected"] = "0" * 64
    other = tmp_path / "other"
    shutil.copytree(bundle, other)
    (other / "manifest.json").write_text(json.dumps(manifest))
    told = surctl("check", "proofs/v1-corrected.json", "--bundle", other, "--json", cwd=tmp_path)
    assert told.status == 1 and told.json["accepted"] and not told.json["bundle"]["belongs"]
    altered, other_claim = told.json["bundle"]["differs"]
    assert "its seal does not match" in altered and "is not the one for" in other_claim
    assert told.json["bundle"]["excludes"]
    none = surctl("check", "proofs/v1-corrected.json", "--bundle", tmp_path, cwd=tmp_path)
    assert none.status == 2 and "manifest.json" in none.complaint
