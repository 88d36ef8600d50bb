"""Study 35: the closed loop in MuJoCo against surctl's own plant, and where four degrees of freedom do not suffice.

    python analysis/35_independent_engine/run.py [--quick] [--write] [--seeds N] [PART...]

Prints Markdown; --write stores it in `parts/` and writes README.md from all parts and the picture. The exit status is 1
if a limit does not hold. --quick: two scenarios with true positions, and the repeatability.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from braking import braked
from campaign import good as arrived
from campaign import stored_runs
from certified import confronted, with_parameters

from surctl.marine.control import build_law, load_gains
from surctl.marine.engine import BatchCase, EngineOptions, mujoco_physics
from surctl.marine.engine.physics import simulate_seeds
from surctl.marine.export import CompiledLaw
from surctl.marine.simulation import LIBRARY, Case, OwnPhysics, Run, Scenario, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, load_vehicle

HERE = Path(__file__).parent
SCENARIOS = tuple(sorted(path.stem for path in LIBRARY.glob("*.toml")))
QUICK = ("pool-behind",)
TILTING = {"sur400": "sur400-tilting", "sur540-flooded": "sur540-tilting"}
TIME, CLEARANCE, PATH = 0.2, 0.003, 0.002  # [s, m, m] limits of the differences with four degrees of freedom
TRUTH, SONAR = 20.0, 5.0  # limits of the real-time factors
PICTURE = 0.1  # [s] limit of the processor time of a picture
GAINS = load_gains("default")

Part = tuple[str, bool]


def table(head: str, rows: list[list[str]]) -> str:
    """Return a Markdown table; the cells of `head` are separated by semicolons."""
    cells = [[cell.strip() for cell in head.split(";")], *rows]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]])


def six(scenario: Scenario) -> Vehicle:
    """Return the vehicle of the scenario with stated centres."""
    return load_vehicle(TILTING[scenario.vehicle])


def simulated(
    scenario: Scenario, vehicle: Vehicle, physics: object, *, sensing: str = "truth", seeds: int = 1
) -> list[Run]:
    """Return the runs with the first seeds."""
    case = Case(scenario, vehicle, GAINS, sensing="sonar" if sensing == "sonar" else "truth")
    return list(simulate_seeds(BatchCase(case, physics), range(seeds)))  # type: ignore[arg-type]


def cell(runs: list[Run]) -> str:
    """Return how runs end: time [s], clearance [m], path error [m]; the ranges over several runs."""
    times, clear, error = ([getattr(r.metrics, n) for r in runs] for n in ("time_s", "min_clearance_m", "path_error_m"))
    ended = sorted({r.metrics.stopped_because for r in runs} - {"reached"})
    said = f"{', '.join(ended)}: " if ended else ""
    if len(runs) == 1:
        return f"{said}{times[0]:.2f}, {clear[0]:.4f}, {error[0]:.4f}"
    return f"{said}{min(times):.1f}–{max(times):.1f}, {min(clear):.3f}, {max(error):.3f}"


def good(run: Run) -> bool:
    """Return whether a run arrives without contact."""
    return run.metrics.reached and run.metrics.min_clearance_m > 0 and not run.contacts


def differences(one: Run, other: Run) -> tuple[float, float, float]:
    """Return the differences of time [s], clearance [m] and path error [m]."""
    a, b = one.metrics, other.metrics
    return (
        abs(a.time_s - b.time_s),
        abs(a.min_clearance_m - b.min_clearance_m),
        abs(a.path_error_m - b.path_error_m),
    )


def truth(names: tuple[str, ...], seeds: int) -> Part:
    """All scenarios with true positions."""
    rows, held, largest = [], True, np.zeros((2, 3))
    for name in names:
        scenario = load_scenario(name)
        count = seeds if scenario.seeded else 1
        flat = load_vehicle(scenario.vehicle)
        four = [simulated(scenario, flat, physics, seeds=count) for physics in (OwnPhysics, mujoco_physics())]
        full = [simulated(scenario, six(scenario), physics, seeds=count) for physics in (OwnPhysics, mujoco_physics())]
        for k, (mine, theirs) in enumerate((four, full)):
            for one, other in zip(mine, theirs, strict=True):
                largest[k] = np.maximum(largest[k], differences(one, other))
        held = held and all(map(good, (*four[1], *full[1])))
        tilt = max(float(np.rad2deg(np.abs(run.record.tilt).max())) for run in full[1] if run.record.tilt is not None)
        rows.append([name, str(count), *(cell(runs) for runs in (*four, *full)), f"{tilt:.1f}"])
        print(rows[-1], file=sys.stderr, flush=True)
    held = held and bool(np.all(largest[0] <= (TIME, CLEARANCE, PATH)))
    shown = [f"{t:.2f} s, {1000 * c:.2g} mm and {1000 * e:.2g} mm" for t, c, e in largest.tolist()]
    head = "scenario; seeds; own, 4 DoF: time [s], clearance [m], path error [m]; MuJoCo, 4 DoF; own, 6 DoF; "
    text = f"""## True positions
Over several seeds: range of times, smallest clearance, largest path error. The largest differences of time, clearance
and path error between the two engines are {shown[0]} with four degrees of freedom (limits: {TIME:g} s,
{1000 * CLEARANCE:g} mm, {1000 * PATH:g} mm), and {shown[1]} with six.
All runs in MuJoCo arrive without contact, within the limits: {"yes" if held else "**no**"}.

{table(head + "MuJoCo, 6 DoF; largest tilt [deg]", rows)}"""
    return text, held


def sonar(names: tuple[str, ...], seeds: int) -> Part:
    """All scenarios with sonars; the runs are stored one by one."""
    rows, total, touched, runs = [], 0, 0, 0
    scenarios = [load_scenario(name) for name in names]
    theirs = stored_runs(
        HERE / "parts" / "sonar.csv",
        [Case(scenario, six(scenario), GAINS, sensing="sonar") for scenario in scenarios],
        mujoco_physics(),
        seeds,
        stepper=CompiledLaw,
    )
    for scenario, found in zip(scenarios, theirs, strict=True):
        mine = Case(scenario, load_vehicle(scenario.vehicle), GAINS, sensing="sonar")
        batch = simulate_batch(mine, seeds=np.array([int(row["seed"]) for row in found]), threads=1)
        own = [batch.column(name) for name in ("time_s", "min_clearance_m", "path_error_m")]
        in_engine = [np.array([float(row[key]) for row in found]) for key in ("time_s", "clearance_m", "path_error_m")]
        reached, contacts = sum(map(arrived, found)), sum(bool(row["contacts"]) for row in found)
        total, touched, runs = total + reached, touched + contacts, runs + len(found)
        ranges = [f"{t.min():.1f}–{t.max():.1f}, {c.min():.3f}, {e.max():.3f}" for t, c, e in (own, in_engine)]
        arrivals = int(batch.column("reached").sum())
        tilt = max(float(row["tilt_deg"]) for row in found)
        counts = [str(count) for count in (len(found), arrivals, reached, contacts)]
        rows.append([scenario.name, counts[0], *ranges, *counts[1:], f"{tilt:.1f}"])
        print(rows[-1], file=sys.stderr, flush=True)
    head = "scenario; seeds; own, 4 DoF: time [s], smallest clearance [m], largest path error [m]; MuJoCo, 6 DoF; "
    text = f"""## Sonars
The own plant has a horizontal fan in the plane; MuJoCo traces {EngineOptions().count} rays in a cone in space, which
rolls and pitches with the hull. The law is C in the process. In MuJoCo {total} of {runs} runs arrive without contact,
and {touched} have a contact. The runs are in `parts/sonar.csv`; `run.py sonar` simulates those that are missing of 20
seeds.

{table(head + "arrived, own; arrived without contact, MuJoCo; runs with contact; largest tilt [deg]", rows)}"""
    return text, total == runs


def models(names: tuple[str, ...], seeds: int) -> Part:
    """Tilt, buoyancy, drag and echoes."""
    scenario = load_scenario("tank-static")
    usual = six(scenario)
    dry = 7.9 / (usual["weight"] / 9.81)  # share of the weight that is not water

    def centres(down: float, arm: float) -> Vehicle:
        return with_parameters(usual, {"zg": -down * dry, "zt": -arm})

    cases: list[tuple[str, Vehicle, EngineOptions, str]] = [
        ("centre of gravity 5 cm, jets 5 cm below the centre", usual, EngineOptions(), "truth"),
        ("3 cm, 5 cm", centres(0.03, 0.05), EngineOptions(), "truth"),
        ("1.5 cm, 6 cm", centres(0.015, 0.06), EngineOptions(), "truth"),
        ("1 cm, 10 cm", centres(0.01, 0.10), EngineOptions(), "truth"),
        ("surface, hull drains, ballasted for this depth", usual, EngineOptions(surface=dry), "truth"),
        ("surface, hull keeps its water, ballasted", usual, EngineOptions(surface=1.0), "truth"),
        ("surface, hull drains, not ballasted", usual, EngineOptions(surface=dry, ballast="none"), "truth"),
        ("surface, keeps its water, not ballasted", usual, EngineOptions(surface=1.0, ballast="none"), "truth"),
        ("drag by the speed", usual, EngineOptions(drag="speed"), "truth"),
        ("MuJoCo's ellipsoid drag", usual, EngineOptions(drag="ellipsoid"), "truth"),
        ("sonar, cone of rays", usual, EngineOptions(), "sonar"),
        ("sonar, horizontal fan of rays", usual, EngineOptions(rays="fan"), "sonar"),
        ("sonar, the floor reflects", usual, EngineOptions(floor=True), "sonar"),
        ("sonar, the water surface reflects", usual, EngineOptions(surface_echo=True), "sonar"),
    ]
    rows = []
    for what, vehicle, options, sensing in cases:
        run = simulated(scenario, vehicle, mujoco_physics(options), sensing=sensing)[0]
        assert run.record.tilt is not None
        tilt = float(np.rad2deg(np.abs(run.record.tilt).max()))
        depth = float(np.abs(run.record.eta[:, 2] - scenario.depth).max())
        ended, m = run.metrics.stopped_because, run.metrics
        touched = ", ".join(contact.what for contact in run.contacts) or "none"
        numbers = [
            f"{m.time_s:.2f}",
            f"{m.min_clearance_m:.4f}",
            f"{m.path_error_m:.4f}",
            f"{tilt:.1f}",
            f"{depth:.3f}",
        ]
        rows.append([what, ended, *numbers, touched])
        print(rows[-1], file=sys.stderr, flush=True)
    head = "model; end; time [s]; clearance [m]; path error [m]; largest tilt [deg]; largest depth error [m]; contacts"
    text = f"""## Where four degrees of freedom must not be trusted
`tank-static`, seed 0, MuJoCo with six degrees of freedom; the hull's upper 12 cm are above the water.

{table(head, rows)}"""
    return text, True


def speed(names: tuple[str, ...], seeds: int) -> Part:
    """Real-time factor and repeatability."""
    rows, held = [], True
    for name in ("pool-static", "tank-static", "tank-moving"):
        scenario = load_scenario(name)
        vehicle = six(scenario)
        row = [name]
        for sensing, limit in (("truth", TRUTH), ("sonar", SONAR)):
            law = build_law(
                sonar=sensing == "sonar",
                equipment=scenario.sensors.on(vehicle["radius"]),
                depths=scenario.depths is not None,
            )
            factors = []
            for _ in range(3):
                stepper = CompiledLaw(law)
                began = time.process_time()
                run = simulate(
                    scenario, vehicle, gains=GAINS, law=law, sensing=sensing, stepper=stepper, physics=mujoco_physics()
                )
                factors.append(run.metrics.time_s / (time.process_time() - began))
            differing = stepper.report().differing
            held = held and max(factors) >= limit and differing == 0
            row += [f"{max(factors):.0f}", str(differing)]
        rows.append(row)
        print(row, file=sys.stderr, flush=True)
    again = repeats("tank-static")
    held = held and again
    head = (
        "scenario; truth: times real time; steps in which C and Python differ; sonar: times real time; differing steps"
    )
    text = f"""## Speed and repeatability
Simulated time over processor time of one core, law as C in the process, six degrees of freedom, best of three runs.
Limits: {TRUTH:g} with true positions, {SONAR:g} by sonar. A run by sonar, repeated in another process, has the same
bytes: {"yes" if again else "**no**"}.

{table(head, rows)}"""
    return text, held


def pictures(names: tuple[str, ...], seeds: int) -> Part:
    """Processor time of a picture."""
    from surctl.marine.engine import CAMERAS, Moment, Scene

    scenario = load_scenario("tank-static")
    vehicle = six(scenario)
    moment = Moment(scenario.start_pose, (0.1, 0.0), build_world(scenario, vehicle, seed=0).bodies(0.0))
    times = []
    with Scene(scenario, vehicle) as scene:
        scene.picture("above", moment)  # the first picture loads the scene
        for camera in CAMERAS * 5:
            began = time.process_time()
            scene.picture(camera, moment)
            times.append(time.process_time() - began)
    held = float(np.mean(times)) <= PICTURE
    text = f"""## Pictures
A picture of 640×360 pixels takes {1000 * np.mean(times):.0f} ms of processor time, without a graphics card (limit:
{1000 * PICTURE:.0f} ms)."""
    return text, held


def certified(names: tuple[str, ...], seeds: int) -> Part:
    """Starts inside a certified region."""
    return confronted(GAINS, 50 * seeds)


def braking(names: tuple[str, ...], seeds: int) -> Part:
    """Runs towards an obstacle under the rule of a braking claim."""
    return braked(GAINS, 50 * seeds, HERE / "parts" / "braking.csv")


def repeats(name: str) -> bool:
    """Return whether two runs by sonar, in two processes, have the same bytes."""
    scenario = replace(load_scenario(name), time_limit=20.0)
    case = Case(scenario, six(scenario), GAINS, sensing="sonar")
    runs = list(simulate_seeds(BatchCase(case, mujoco_physics()), [0, 0], processes=2))
    one, other = (np.hstack([run.record.eta, run.record.nu, run.record.tau]).tobytes() for run in runs)
    here = next(simulate_seeds(BatchCase(case, mujoco_physics()), [0])).record
    return one == other == np.hstack([here.eta, here.nu, here.tau]).tobytes()


def picture() -> None:
    """Write the picture: tank-static by sonar at its smallest clearance."""
    from PIL import Image

    from surctl.marine.engine import Scene
    from surctl.marine.report.animation import moment_of

    scenario = load_scenario("tank-static")
    run = simulated(scenario, six(scenario), mujoco_physics(), sensing="sonar")[0]
    moment = moment_of(run, int(np.argmin(run.record.clearance)))
    with Scene(scenario, run.vehicle) as scene:
        above, side, nose = (scene.picture(camera, moment) for camera in ("above", "side", "nose"))
    below = np.hstack([side[::2, ::2], nose[::2, ::2]])
    Image.fromarray(np.vstack([above, below])).save(HERE / "scene.png", optimize=True)


PARTS: dict[str, Callable[[tuple[str, ...], int], Part]] = {
    "truth": truth,
    "sonar": sonar,
    "models": models,
    "speed": speed,
    "pictures": pictures,
    "certified": certified,
    "braking": braking,
}


def chosen(options: argparse.Namespace) -> Iterator[tuple[str, Part]]:
    """Yield the results of the requested parts."""
    if options.quick:
        text, held = truth(QUICK, 1)
        yield "quick", (f"{text}\n", held)
        return
    for name in options.parts or PARTS:
        yield name, PARTS[name](SCENARIOS, options.seeds)


def main() -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--quick", action="store_true", help="one scenario by true positions")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="seeds of each scenario (default 20)")
    parser.add_argument("--write", action="store_true", help="write the parts, README.md and the picture")
    options = parser.parse_args()
    passed = True
    for name, (text, held) in chosen(options):
        print(text, "\n")
        passed = passed and held
        if options.write:
            (HERE / "parts").mkdir(exist_ok=True)
            (HERE / "parts" / f"{name}.md").write_text(text + "\n")
    if options.write:
        if "pictures" in (options.parts or PARTS):
            picture()
        parts = [HERE / "parts" / f"{name}.md" for name in PARTS]
        texts = [HERE.joinpath("about.md").read_text(), *(part.read_text() for part in parts if part.exists())]
        HERE.joinpath("README.md").write_text("\n".join(texts))
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
