"""`surctl fly`: let the exported law steer an ArduSub vehicle, or rehearse it with a simulated autopilot."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any

import click

from surctl.cli.options import FOLDER, Count, FiniteRange, changed, option, options
from surctl.cli.output import Stopped, as_json, finish, progress, waiting
from surctl.errors import InputError, SurctlError, check_known
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import RobotOptions, choose_gains, choose_law, choose_vehicle

_SYSTEM = click.IntRange(1, 255)


@dataclass(frozen=True, eq=False, repr=False)
class _Link:
    """How surctl meets the autopilot, or the simulated one of a rehearsal."""

    mavlink: str | None = option(
        "--mavlink", "Link to the autopilot: udp:HOST:PORT (listen) or udpout:HOST:PORT (send).", metavar="URL"
    )
    dry_run: bool = option("--dry-run", "Rehearse with a simulated autopilot, in simulated time.", False)
    mode: str = option(
        "--mode",
        "Mode of the autopilot in which surctl steers: alt_hold (default), manual or guided.",
        "alt_hold",
        metavar="NAME",
    )
    send: str = option(
        "--send",
        "MAVLink message for thrust: rc (channel overrides, default) or manual (MANUAL_CONTROL).",
        "rc",
        metavar="NAME",
    )
    origin: str = option(
        "--origin",
        "Origin of the autopilot's coordinates: X,Y in the scenario [m], and compass direction [deg] of the "
        "scenario's x axis (default 0,0,90).",
        "0,0,90",
        metavar="X,Y,DEG",
    )
    yaw_rate: float = option(
        "--yaw-rate",
        "Yaw rate of the vehicle at full stick [deg/s] (default 45).",
        45.0,
        type=FiniteRange(min=1.0, max=360.0),
        metavar="DEG/S",
    )
    target: int = option("--target", "MAVLink system id of the autopilot (default 1).", 1, type=_SYSTEM, metavar="N")
    system: int = option("--system", "MAVLink system id of surctl fly (default 255).", 255, type=_SYSTEM, metavar="N")
    loss: float = option(
        "--loss",
        "Rehearsal: probability that a message is lost (default 0).",
        0.0,
        type=FiniteRange(0.0, 1.0),
        metavar="P",
    )
    delay: float = option(
        "--delay",
        "Rehearsal: delay of each message [s] (default 0).",
        0.0,
        type=FiniteRange(0.0, 60.0),
        metavar="S",
    )
    acts: tuple[str, ...] = option(
        "--act",
        "Rehearsal: event ACT at time S [s], repeatable: arm, disarm, a mode of --mode, reboot (of the autopilot), "
        "cut (no link), blind (no position), join (ends cut and blind) or quit (surctl fly is killed).",
        (),
        metavar="S:ACT",
    )
    seed: int = option("--seed", "Rehearsal: seed of the message loss (default 0).", 0, type=Count(0))


@click.command
@click.argument("scenario")
@options(robot=RobotOptions, link=_Link, only={"robot": ("vehicle", "gains", "law", "sensing")})
@click.option("--out", type=FOLDER, help="Folder for the record (default surctl-out/fly; in a rehearsal, none).")
@as_json
def fly(scenario: str, robot: RobotOptions, link: _Link, out: Path | None, as_json: bool) -> None:
    """Steer a vehicle whose autopilot is ArduSub along the path of a scenario by an exported law, over MAVLink.

    surctl fly steers only after the operator arms the vehicle in the mode of --mode, and never arms the vehicle. If the
    link or the measured position is lost, surctl fly sends neutral commands; after a long loss, a restart of the
    autopilot or a change of mode, the operator must disarm and arm the vehicle again. Before the first use, read
    notebooks/guides/field.md. Exit status: 1 if the vehicle does not arrive, or collides in a rehearsal.

    Examples: surctl fly tank-speed-015 --dry-run; surctl fly tank-speed-015 --mavlink udp:0.0.0.0:14550
    """
    if (link.mavlink is None) == (not link.dry_run):
        raise InputError("needs one of --mavlink and --dry-run", key="surctl fly", remedy="begin with --dry-run")
    alone = [name for name in changed(link) if name in ("--loss", "--delay", "--act")]
    if alone and not link.dry_run:
        raise InputError("is only for a rehearsal", key=alone[0], remedy="add --dry-run, and leave out --mavlink")
    if link.target == link.system:
        remedy = "give two different ids"
        raise InputError("is the system id of the bridge", key="--target", value=link.target, remedy=remedy)
    check_known(robot.sensing, lib.SENSING, key="--sensing")
    address = None if link.mavlink is None else lib.parse_address(link.mavlink)
    lib.mode_of(link.mode)
    wire, script = lib.Wire(target=link.target, system=link.system, send=link.send), [_act(text) for text in link.acts]
    site = lib.parse_site(link.origin)
    mission = lib.load_scenario(scenario)
    choice = choose_vehicle(robot.vehicle, (mission.name, mission.vehicle))
    vehicle = lib.load_vehicle(choice.word)
    reference, lines = choose_law(robot.law, [vehicle])
    tuned = choose_gains(robot.gains, vehicle, cruise=mission.cruise, own=lib.law_source(reference).gains)
    progress("building and compiling the law")
    plan = lib.plan_session(
        mission,
        vehicle,
        gains=tuned.gains,
        law=reference,
        sonar=robot.sensing == "sonar",
        mode=link.mode,
        site=site,
        full_rate=radians(link.yaw_rate),
    )
    bridge = lib.Bridge(plan, wire)
    lines += [choice.line(vehicle.name), *tuned.lines]
    lines.append(f"controller {plan.controller.bundle.id[:12]}; mode {link.mode}: {plan.mapping.mode.what}")
    if out is not None or address is not None:
        out = out or Path("surctl-out", "fly")
        lib.prepare_folder(out)
    if address is None:
        quality = lib.LinkQuality(loss=link.loss, delay=link.delay)
        result = _rehearsed(bridge, quality, script, out=out, seed=link.seed)
        files = [] if out is None else sorted(str(path) for path in out.glob(f"{_stem(mission, link.seed)}.*"))
        lines += [f"{at:8.2f} s  {text}" for at, text in result.texts] + [_summary(result), *files]
        passed, brief = result.arrived and not result.touched, [_summary(result), *(text for _, text in result.texts)]
        data, where = _data(result) | {"files": files}, [] if out is None else [f"record {out}"]
        finish(data, lines, as_json=as_json, passed=passed, brief=brief, files=where)
    assert out is not None and address is not None
    for line in lines:
        progress(line)
    arrived, files = _live(bridge, address, out)
    lines = ["arrived" if arrived else "not arrived", *files]
    finish({"arrived": arrived, "files": files}, lines, as_json=as_json, passed=arrived)


def _live(bridge: lib.Bridge, address: lib.Address, out: Path) -> tuple[bool, list[str]]:
    waiting()
    with lib.SessionRecord(out, f"session-{time.strftime('%Y%m%d-%H%M%S')}", bridge) as record:
        files = [str(path) for path in record.files]
        try:
            return lib.run_session(bridge, address, log=record, said=progress), files
        except (KeyboardInterrupt, lib.Ended) as end:
            why = f" ({end})" if isinstance(end, lib.Ended) else ""
            raise Stopped(f"the session ended{why}, the last commands were neutral; record {files[1]}") from None
        except OSError as error:
            raise SurctlError(
                f"the record cannot be written ({error.strerror}); the last commands were neutral"
            ) from None


def _rehearsed(
    bridge: lib.Bridge, quality: lib.LinkQuality, script: Sequence[lib.Act], *, out: Path | None, seed: int
) -> lib.RehearsalResult:
    plan = bridge.plan
    sub = lib.SimulatedSub(
        plan.scenario,
        plan.vehicle,
        site=plan.site,
        full_rate=plan.mapping.full_rate,
        seed=seed,
        sonars=plan.law.perception is not None,
        target=bridge.wire.target,
        system=bridge.wire.system,
    )
    sub.mode = plan.mapping.mode.name
    if out is None:
        return lib.rehearse(bridge, sub, link=quality, seed=seed, acts=script)
    with lib.SessionRecord(out, _stem(plan.scenario, seed), bridge, epoch=0.0, new=False) as record:
        return lib.rehearse(bridge, sub, link=quality, seed=seed, acts=script, log=record)


def _stem(mission: lib.Scenario, seed: int) -> str:
    return f"rehearsal-{lib.file_name(mission.name)}-{seed}"


def _act(text: str) -> lib.Act:
    at, _, action = text.partition(":")
    try:
        time = float(at)
    except ValueError:
        time = -1.0
    if not 0.0 <= time <= 1e5:
        raise InputError("does not begin with a time", key="--act", value=text, remedy="write 20:reboot")
    check_known(action, lib.ACTIONS, key="--act")
    return lib.Act(time, lib.ACTIONS[lib.ACTIONS.index(action)])


def _summary(result: lib.RehearsalResult) -> str:
    time = result.time if result.arrived else result.steered
    end = "arrived after" if result.arrived else "did not arrive; steered for"
    touched = ", but touched an obstacle or wall" if result.touched else ""
    text = f"{end} {time:.2f} s{touched}, least clearance {result.clearance:.3f} m"
    for act, after in result.neutral_after:
        text += f"; {act.action} at {act.time:g} s: neutral after {after:.2f} s"
    for act in result.missed:
        text += f"; {act.action} at {act.time:g} s: did not happen, the rehearsal ended before"
    return text


def _data(result: lib.RehearsalResult) -> dict[str, Any]:
    return {
        "arrived": result.arrived,
        "time_s": result.time,
        "min_clearance_m": result.clearance,
        "touched": result.touched,
        "steered_s": result.steered,
        "phases": dict(result.phases),
        "neutral_after_s": [[act.action, act.time, after] for act, after in result.neutral_after],
        "missed": [[act.action, act.time] for act in result.missed],
        "begun": result.begun,
        "invalid_frames": result.bad,
        "texts": [list(one) for one in result.texts],
    }
