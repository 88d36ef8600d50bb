"""A stack of tasks and limits of a robot as a controller: steps, damping, budget, explanations, closed loops, C."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NoReturn, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, SurctlError, nearest
from surctl.export import CheckReport, build_controller, check_builds, write_bundle
from surctl.export.bundle import build_bundle, check_folder
from surctl.export.emulated import chosen_targets
from surctl.export.envelope import as_records
from surctl.ir import Block, Call, Layout, Port, Routine, lower, lower_named, replay, without_libm
from surctl.ir.procedure import Procedure
from surctl.priority import Assembly, Mode, PriorityProblem, PrioritySolution, assemble, priority_step
from surctl.priority.compiled.step import OUTPUTS, Stage
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.shapes import StackShape
from surctl.priority.solver.fallback import CLAMPED, LIMITED, MET, RELAXED, UNCONFIRMED
from surctl.priority.solving import explained
from surctl.robot.kinematics import Kinematics
from surctl.robot.limits import JointLimits, SelfCollision
from surctl.robot.robot import RobotTask, flat_pose
from surctl.system import NONFINITE, Controller, Cost, Plant, System, run_system
from surctl.system.loop import Signals
from surctl.tasks import Limit, SetTask, Stack, Task
from surctl.units import as_numbers, is_number

Array: TypeAlias = NDArray[np.float64]

_BITS = {RELAXED: 1, UNCONFIRMED: 2, CLAMPED: 4}
_STAGES = get_args(Stage)
_PROBLEM = ("J", "lower", "upper", "rows")
_MISSED = 10.0  # in the damping: with 1, the tasks below chatter more; with 30, they are slower (study 45)
_CHECKED_SECONDS, _CHECKED_RUNS, _CHECKED_STEPS = 2.0, 3, 300
_SAMPLES, _LARGEST = 20, 2**31 - 1  # configurations; budget


class StackController:
    """Joint velocities from tasks in strict order of priority, within limits.

    A step solves one priority problem with `surctl.priority`. The velocities of the last step are the state of the
    controller, which the acceleration limits need.

    Attributes:
        robot: the robot. dt: control period [s]. stack: the tasks. limits: the limits.
        controller: the same law as `surctl.system.Controller`, for any closed loop. Inputs: the configuration q and the
            targets of the tasks. Command: the velocity v. Gains: gains, largest speeds and postures of the tasks.
            Telemetry: `stage` of the solution (1 met, 2 limited, 3 relaxed, 4 clamped, 6 unconfirmed; see
            `surctl.priority`), and `active`, the numbers of the limits that bind. If v misses more than half of the
            desired rate of the first task, the stage is limited, too, even if no limit binds: the target is out of
            reach, or the configuration is singular. Status: 0 for stages 1 and 2, else 1 (relaxed), 2 (unconfirmed) or
            4 (clamped).

    Args:
        tasks: tasks of one robot, highest priority first; also any `Task` or `SetTask` of `robot.q` with
            `kinematics=robot.rate_map`.
        limits: limits of the same robot; the earlier of two actuator limits that exclude each other is harder.
        dt: control period [s].
        name: name of the controller, a C identifier.
        mode: priority mode of `surctl.priority`.
        damping: c ≥ 0 [unit of a task · s], such as 0.05 m·s, for targets out of reach and singular configurations. For
            its desired rate x, each task in turn gets the v that minimises ‖J v − x‖² + c ‖x‖ ‖v‖² within the limits
            and with the rates of the tasks above (singular values of their J below 1e-8·‖J‖ count as 0); so `mode` must
            be lexicographic. It adds at most ‖J u − x‖²/(c ‖x‖) to ‖u‖², where u is the velocity of the tasks above (0
            for the first task, if the limits contain 0). The loss: for a singular value σ of the J that is left, that
            part of x is multiplied by σ²/(σ² + c ‖x‖), which tends to 1 as the target is reached. With 0, velocities
            may chatter at such targets; with damping, those of the first task do not, but those that serve other tasks
            may, because they are free at a singular configuration and bound next to it. To damp this, ‖x‖ beside c
            stands for √(‖x‖² + 100 m²), where m is what the last v missed of the desired rates of the tasks above.
        budget: most operations of a step, for a hard real-time bound; `mode` must be lexicographic. An operation takes
            about five instructions of a Cortex-M7. If the search does not end within the budget, it ends early and the
            stage is unconfirmed. Let v₀ be v = 0 clipped to the bounds of each velocity. If v₀ is within the actuator
            limits, v is too, and exceeds no other limit by more than v₀ exceeds the worst one. Otherwise v may exceed
            other limits by more, or actuator limits; in the second case the stage is clamped. All other steps have the
            same bytes as without a budget. For seven joints (study 42), 80,000 suffice for nearly all problems in which
            v = 0 is allowed; if limits of acceleration forbid it, 145,000 do. With None, a step takes as many
            operations as it needs, and the bound on them is several times higher.

    Raises:
        InputError: tasks or limits are of different robots, two inputs have the same name but differ, the period is not
            positive, the damping is negative, the budget is too small for any search, or a mode other than
            lexicographic has damping or a budget.

    Example:
        >>> from pathlib import Path
        >>> from surctl.robot import StackController, load_urdf
        >>> links = '<link name="base"/><link name="cart"/>'
        >>> ends = '<parent link="base"/><child link="cart"/><limit lower="-1" upper="1" velocity="0.5"/>'
        >>> joint = f'<joint name="rail" type="prismatic">{ends}</joint>'
        >>> _ = Path("cart.urdf").write_text(f"<robot>{links}{joint}</robot>")
        >>> cart = load_urdf("cart.urdf")
        >>> place = cart.frame_task("cart", target="place", gain=2.0).position
        >>> control = StackController([place], limits=[cart.joint_limits(acceleration=1.0)], dt=0.1)
        >>> control.step([0.0], place=[0.9, 0, 0, 0, 0, 0, 1]).round(3).tolist(), control.explain()
        ([0.1], 'Task `place_position` gave up 1.7 m/s because `joint.rail` (upper acceleration limit 1 m/s²) binds.')
    """

    def __init__(
        self,
        tasks: Sequence[Task | SetTask],
        *,
        limits: Sequence[Limit] = (),
        dt: float,
        name: str = "stack",
        mode: Mode = "lexicographic",
        damping: float = 0.0,
        budget: int | None = None,
    ) -> None:
        self.robot = _robot_of(tasks, limits)
        split = (part for task in tasks for part in (task.split() if isinstance(task, SetTask) else (task,)))
        self.stack, self.limits, self.dt = Stack(tuple(split)), tuple(limits), dt
        if not is_number(damping) or not 0.0 <= damping < math.inf:
            raise InputError("is not a number of at least 0", key="damping", value=damping, remedy="give 0, or 0.05")
        if (damping or budget is not None) and mode != "lexicographic":
            word = "damping" if damping else "budget"
            raise InputError(
                f"has no {word}", key="mode", value=mode, remedy=f"take lexicographic, or leave out {word}"
            )
        if budget is not None and (not isinstance(budget, int | np.integer) or isinstance(budget, bool)):
            raise InputError("is not a whole number", key="budget", value=budget, remedy="give operations of a step")
        targets, gains, self._symbols = _inputs_of(self.robot, self.stack)
        damped = _damped(self.stack, self.robot) if damping else self.stack
        self._assembly = assemble(damped, self.limits, inputs=self._symbols)
        self._targets = tuple(port.name for port in targets)
        q, v = self.robot.layout()
        rates = [task.reference() for task in damped.tasks if isinstance(task, Task)]
        ends = [row.upper - row.lower for row in self._assembly.limits]
        remembers = any(ca.depends_on(part, self.robot.v) for part in (*rates, *ends))
        state = (Port("previous", v.shape, v.unit, "velocity of the last period", 0.0, "anew"),) if remembers else ()
        outcome = (Port("stage", (1,), "1", "stage of the solution"), Port("active", (self.robot.nv,), "1", "limits"))
        law = partial(
            _Law, name, dt, Layout((q, *targets)), Layout((v,)), _no_expressions, Layout(state), Layout(gains),
            Layout(outcome), assembly=self._assembly, mode=mode, damping=damping,
        )  # fmt: skip
        try:
            self.controller: _Law = law(budget=None if budget is None else int(budget))
        except InputError as error:
            if error.problem != "is too small":
                raise
            self.controller = law(budget=_LARGEST)
            remedy = f"{error.remedy}, such as {self._useful_budget}, which suffices at random configurations"
            raise InputError(error.problem, key=error.key, value=error.value, remedy=remedy) from None
        self._mode: Mode = mode
        self._state = self.controller.initial_state()
        self._last: tuple[Array, Array, Array] | None = None

    @property
    def targets(self) -> tuple[str, ...]:
        """Return the names of the targets that `step` needs."""
        return self._targets

    def step(self, q: ArrayLike, **values: ArrayLike) -> Array:
        """Return the velocities v (nv,) at configuration q (nq,), and store them for the next step.

        If a number is not finite, v is 0 and the stored velocity stays.

        Args:
            q: configuration; see `Kinematics`.
            values: every target by name, as the numbers of its port or, for a pose, a homogeneous matrix (4, 4); and
                gains that differ from their nominal values.

        Raises:
            InputError: a target is missing, a name is unknown, or a size is wrong.
        """
        u, p = self._arguments(q, values)
        step = self.controller.step(self._state, u, p)
        if step.status != NONFINITE:
            self._last = (np.concatenate([self._state, u, p]), step.telemetry, step.tau)
        self._state = step.x_next
        return step.tau

    def reset(self, v: ArrayLike | None = None) -> None:
        """Forget the velocities of the last step, or replace them by v (nv,)."""
        self._state = self.controller.initial_state()
        if v is not None and self._state.size:
            self._state = as_numbers(v, key="v", size=self.robot.nv)

    @property
    def stage(self) -> Stage:
        """Return how the last step was solved, such as "met" or "limited"; see `surctl.priority`."""
        stage: Stage = _STAGES[int(self._before()[1][0]) - 1]
        return stage

    def binding(self) -> dict[str, str]:
        """Return the limits that bound the velocities of the last step by name, each with the bound that was reached.

        For `JointLimits`, the text says which limit gives the bound, such as "upper acceleration limit 5 rad/s²".
        """
        problem, rows = self.problem(), [row.name for row in self._assembly.limits] or [""]
        names = [*rows, *(task.name for task in self.stack.tasks if isinstance(task, SetTask))]
        uppers = {names[int(abs(k)) - 1]: bool(k > 0) for k in self._before()[1][1:] if k != 0.0}
        causes = self._causes(problem, uppers)
        return {name: causes.get(name, "upper bound" if upper else "lower bound") for name, upper in uppers.items()}

    def explain(self) -> str:
        """Return sentences about the last step: what each task gave up, by how much, and for which limit."""
        solution = self.solution()
        causes = self._causes(solution.problem, {name: multiplier > 0.0 for name, multiplier in solution.binding})

        def with_cause(name: re.Match[str]) -> str:
            text = causes.pop(name[1], "")  # at the first mention alone
            return f"{name[0]} ({text})" if text else name[0]

        text = re.sub("`([^`]+)`", with_cause, solution.explain())
        if self.controller.budget is None or self.stage != "unconfirmed":
            return text
        return (
            f"{text} If the budget ended the search, raise it: {self._useful_budget} suffices at random configurations."
        )

    @cached_property
    def _useful_budget(self) -> int:
        """Return a budget of two digits within which the searches at random configurations end."""
        law, draws, most = replace(self.controller, budget=_LARGEST), np.random.default_rng(0), 0.0
        assert isinstance(law.block, Routine)
        before, search, _ = (step for step in law.block.steps if isinstance(step, Call))
        kernel = search.block
        assert isinstance(kernel, Procedure)
        spent = "\n    s.target[0] = 1.0 * s.spent"  # in the last output
        counting = replace(kernel, source=kernel.source + spent, bounded=kernel.bounded + spent)
        for _ in range(_SAMPLES):
            u, p = self._arguments(self.robot.sample(draws), self._sample(draws))
            problem = dict(zip(before.results, replay(before.block, law.initial_state(), u, p), strict=True))
            most = max(most, counting.run([problem[name].tolist() for name in search.args])[-1][0])
        least = law.block.operations - dict(kernel.sizes)["budget"]
        unit = 10 ** (len(str(int(least + most))) - 2)
        return int(-(-(least + most) // unit) * unit)

    def _causes(self, problem: PriorityProblem, uppers: Mapping[str, bool]) -> dict[str, str]:
        """Return, for the rows of joint limits, which limit gives the upper (or else lower) bound of the last step."""
        values = self._values()
        causes = {
            row.name: limit.cause(row.name, up, row.upper if up else row.lower, values["q"], values["v"], self.dt)
            for limit in self.limits
            for row in problem.rows
            if isinstance(limit, JointLimits) and (up := uppers.get(row.name)) is not None
        }
        return {name: text for name, text in causes.items() if text}

    def solution(self) -> PrioritySolution:
        """Return the velocities of the last step with their explanation: residuals, limits that bind, multipliers."""
        return explained(self.problem(), self._before()[2], self.stage, mode=self._mode)

    def problem(self) -> PriorityProblem:
        """Return the priority problem of the last step, without damping."""
        return self._undamped.problem(self._values())

    @cached_property
    def _undamped(self) -> Assembly:
        """Return tasks and limits without the rows of `_damped`."""
        return assemble(self.stack, self.limits, inputs=self._symbols)

    def _values(self) -> dict[str, Any]:
        """Return the inputs of the last step by name."""
        sizes = [self.controller.state.size, self.controller.inputs.size]
        x, u, p = np.split(self._before()[0], np.cumsum(sizes))
        values: dict[str, Any] = {**self.controller.inputs.unpack(u), **self.controller.gains.unpack(p)}
        return values | {"v": x if x.size else np.zeros(self.robot.nv), "dt": self.dt}

    def system(
        self,
        reference: Callable[[ca.SX, Mapping[str, ca.SX]], Mapping[str, ca.SX]] | None = None,
        *,
        costs: Mapping[str, Cost] | None = None,
        stops: Mapping[str, Callable[..., Any]] | None = None,
    ) -> System:
        """Return the closed loop with a robot whose joints follow the commanded velocities: q̇ = S(q) v.

        The system can be simulated, swept, tuned and analysed like any other (`surctl.system`, `surctl.tuning`).

        Args:
            reference, costs, stops: as in `System`; without a reference, a run sets the targets by name, and without
                costs, the costs are the errors ‖σ_d − σ‖ of the tasks at the end of the run.
        """
        costs = {task.name: self._error_of(task) for task in self.stack.tasks} if costs is None else costs
        q, v = self.robot.layout()
        rate = ca.Function("rate", [self.robot.q, self.robot.v], [self.robot.rate_map @ self.robot.v])
        plant = Plant(
            f"{self.controller.name}_robot", Layout((q,)), Layout((v,)),
            lambda x, f, d, p: {"q": rate(x["q"], f["v"])},
        )  # fmt: skip
        return System(plant, self.controller, substeps=1, reference=reference, costs=costs, stops=stops or {})

    def _error_of(self, task: Task | SetTask) -> Cost:
        symbols = {name: symbol for name, symbol in self._symbols.items() if name not in ("v", "dt")}
        size = ca.Function("error", list(symbols.values()), [ca.norm_2(ca.densify(task.error()))])

        def error(s: Signals) -> ca.SX:
            values = {**s.x, **s.r, **s.g}
            return size(*(values[name] for name in symbols))

        return Cost(error, "final", task.unit or "1", f"error of task {task.name}")

    def export(self, folder: str | Path, *, target: str | None = None, name: str | None = None) -> CheckReport:
        """Write the controller as C99, after a check that C and Python compute the same bytes.

        The check replays runs to targets at random configurations, and single steps around them.

        Args:
            folder: folder of the C files.
            target: compiler or emulated processor of the check, such as "cortex-m7" (`surctl.export.TARGETS`); None for
                the C compiler of this machine.
            name: prefix of files and C symbols, by default the name of the controller.

        Raises:
            InputError: the target or the name is not usable. ToolMissing: a tool of the target is not installed.
            SurctlError: C and Python differ.
        """
        folder = Path(folder)
        check_folder(folder)
        tried, _ = chosen_targets([target or "gcc-O2"])
        controller, system = self.controller, self.system()
        bundle = build_bundle(controller, controller.gains.unpack(controller.gains.pack()), name=name)
        draws = np.random.default_rng(0)
        seconds = min(_CHECKED_SECONDS, 100 * self.dt)
        samples = [self._sample(draws) for _ in range(_CHECKED_RUNS)]
        runs = [run_system(system, seconds, {f"reference.{n}": v[None] for n, v in one.items()}) for one in samples]
        with tempfile.TemporaryDirectory(prefix="surctl-robot-") as scratch:
            compiled = build_controller(controller, bundle, Path(scratch))
            report = check_builds(compiled, [as_records(controller, run) for run in runs], tried, steps=_CHECKED_STEPS)
        if not report.passed:
            raise SurctlError(report.summary())
        write_bundle(bundle, folder)
        return report

    def _sample(self, draws: np.random.Generator) -> dict[str, Array]:
        """Return targets of a run, near those of the neutral configuration."""
        ports = [self.controller.inputs.port(name) for name in self._targets]
        nominal = {port.name: np.broadcast_to(np.asarray(port.default, dtype=float), (port.size,)) for port in ports}
        return {name: value + 0.3 * draws.standard_normal(value.shape) for name, value in nominal.items()}

    def _arguments(self, q: ArrayLike, values: Mapping[str, ArrayLike]) -> tuple[Array, Array]:
        inputs, gains = self.controller.inputs, self.controller.gains
        names = [*self._targets, *(port.name for port in gains)]
        for name in values:
            if name not in names:
                raise InputError("is no target or gain of the controller", key=name, remedy=nearest(name, names))
        for name in self._targets:
            if name not in values:
                raise InputError("is missing", key=name, remedy=f"write step(q, {name}=…)")
        parts: tuple[dict[str, object], dict[str, object]] = ({"q": q}, {})
        for name, value in values.items():
            pose = name in self._targets and inputs.port(name).size == 7
            parts[name in gains][name] = flat_pose(value) if pose else value
        return inputs.pack(parts[0]), gains.pack(parts[1])

    def _before(self) -> tuple[Array, Array, Array]:
        if self._last is None:
            raise InputError("has made no step", key="controller", remedy="call step first")
        return self._last


@dataclass(frozen=True, eq=False)
class _Law(Controller):
    """A controller whose step evaluates tasks and limits, and then solves the priority problem."""

    assembly: Assembly = field(kw_only=True)
    mode: Mode = field(kw_only=True)
    damping: float = field(kw_only=True)
    budget: int | None = field(kw_only=True)

    @cached_property
    def block(self) -> Block:
        """Return the step as a routine; see `Controller.block`."""
        assembly, n = self.assembly, self.assembly.stack.velocities
        layouts = {"x": self.state, "u": self.inputs, "p": self.gains}
        flat = [ca.SX.sym(name, layout.size) for name, layout in layouts.items()]
        values = {**self.inputs.split(flat[1]), **self.gains.split(flat[2])}
        values |= {"v": flat[0] if self.state.size else ca.SX.zeros(n), "dt": ca.SX(self.dt)}
        problem = assembly.function.call([values[name] for name in assembly.sizes])
        names = ("J", "lower", "upper", "rows", "box", "moved", "damping")
        outputs = [*map(ca.densify, problem), ca.SX(self.damping)][: len(names) if self.damping else -1]
        before = lower(ca.Function("tasks", flat, outputs, list(layouts), list(names[: len(outputs)])))
        v, moved = ca.SX.sym("v", n), ca.SX.sym("moved", dict(before.outputs)["moved"])
        active, code = ca.SX.sym("active", n), ca.SX.sym("code")
        J, x = (ca.SX.sym(name, dict(before.outputs)[name]) for name in ("J", "lower"))
        k, stage = assembly.shapes[0].rows, code
        if not assembly.shapes[0].is_set:
            missing = x[:k] - ca.reshape(J[: k * n], n, k).T @ v
            stage = ca.if_else(ca.logic_and(code == MET, _stuck(missing, x[:k])), LIMITED, code)
        stage = ca.if_else(ca.logic_and(ca.mmax(moved) > 0, stage < RELAXED), RELAXED, stage)
        bits = sum((bit * (stage == code) for code, bit in _BITS.items()), ca.SX(0))
        after = lower_named(
            "result",
            {"v": v, "active": active, "code": code, "moved": moved, "J": J, "lower": x},
            {"tau": v, "x_next": v[: self.state.size], "status": bits, "telemetry": ca.vertcat(stage, active)},
        )
        results = ("tau", "x_next", "status", "telemetry")
        steps = (
            Call(before, tuple(layouts), names[: len(outputs)]),
            self._solution(without_libm(before).operations + without_libm(after).operations),
            Call(after, ("step_v", "step_active", "step_status", "moved", "J", "lower"), results),
        )
        sizes = tuple((name, layout.size) for name, layout in layouts.items())
        return without_libm(Routine(self.name, sizes, steps, results))

    def _solution(self, others: int) -> Call:
        """Return the call that solves the priority problem; `others` are the operations of the rest of a step."""
        n, shapes, rows = self.assembly.stack.velocities, self.assembly.shapes, max(1, len(self.assembly.limits))
        if self.damping or self.budget is not None:
            shape, damped = StackShape(n, shapes), self.damping != 0.0
            step: Routine | Procedure = hierarchy(shape, rows, damped=damped, budget=self.budget, others=others)
        else:
            step = priority_step(self.mode, n=n, levels=shapes, rows=rows)
        inputs = (*_PROBLEM, "box", "damping")[: len(step.inputs)]
        return Call(step, inputs, tuple(f"step_{name}" for name in OUTPUTS))


def _stuck(missing: ca.SX, x: ca.SX) -> ca.SX:
    """Return whether more than half of a desired rate x is missing."""
    return 4.0 * ca.sumsqr(missing) > ca.sumsqr(x) + 1e-12


def _damped(stack: Stack, robot: Kinematics) -> Stack:
    """Return the stack with a row 0 v = 10 m in each task but the first, so that the damping of x is that of (x, 10 m).

    m is what the last v missed of the desired rates of the tasks above.
    """
    tasks: list[Task | SetTask] = []
    square = ca.SX(0.0)
    for task in stack.tasks:
        tasks.append(task)
        if isinstance(task, SetTask):
            continue
        J, x = task.jacobian(), task.reference()
        if not square.is_zero():
            same = ca.repmat(task.sigma[0], task.size + 1)
            tasks[-1] = RobotTask(
                robot=robot, name=task.name, eta=task.eta, kinematics=task.mapping, sigma=same, target=same,
                rate=ca.vertcat(x, ca.sqrt(square + 1e-24)), geometric=ca.vertcat(J, ca.SX.zeros(1, robot.nv)),
            )  # fmt: skip
        # the last v was computed with the J of the last configuration
        J_dot_v = ca.jtimes(J @ robot.v, task.eta, task.mapping @ robot.v)
        square += _MISSED**2 * ca.sumsqr(x - J @ robot.v + robot.dt * J_dot_v)
    return Stack(tuple(tasks))


def _no_expressions(*_: object) -> NoReturn:
    raise InputError("is computed by loops", key="law", remedy="use the block of the controller")


def _robot_of(tasks: Sequence[Task | SetTask], limits: Sequence[Limit]) -> Kinematics:
    members: Any
    for key, members in (("tasks", tasks), ("limits", limits)):
        if not isinstance(members, Sequence):
            raise InputError("is not a list", key=key, value=type(members).__name__, remedy=f"write [{key[:-1]}]")
    one: Any
    for one in tasks:
        if not isinstance(one, Task | SetTask):
            remedy = "of a frame task, take .position and .orientation"
            raise InputError("is not a task", key="tasks", value=type(one).__name__, remedy=remedy)
    robots = [task.robot for task in tasks if isinstance(task, RobotTask)]
    robots += [limit.robot for limit in limits if isinstance(limit, JointLimits | SelfCollision)]
    if not robots:
        raise InputError("has no task of a robot", key="tasks", remedy="take tasks from a robot, as robot.posture_task")
    if any(robot is not robots[0] for robot in robots):
        raise InputError("are of different robots", key="tasks and limits", remedy="load the robot once")
    return robots[0]


def _inputs_of(robot: Kinematics, stack: Stack) -> tuple[list[Port], list[Port], dict[str, ca.SX]]:
    """Return the ports of targets and of gains, and the symbol of each input of the priority problem by name."""
    ports: tuple[list[Port], list[Port]] = ([], [])
    symbols = {"q": robot.q, "v": robot.v, "dt": robot.dt}
    for task in stack.tasks:
        for source in task.inputs if isinstance(task, RobotTask) else ():
            name = source.port.name
            if name not in symbols:
                symbols[name] = source.symbol
                ports[source.tunable].append(source.port)
            elif symbols[name] is not source.symbol:
                raise InputError("is the name of two inputs", key=f"task {task.name}", value=name, remedy="rename one")
    return *ports, symbols
