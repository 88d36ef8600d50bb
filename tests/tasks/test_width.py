"""Tasks, limits and barriers of any number of velocities."""

from functools import partial

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.priority import assemble, solve
from surctl.tasks import (
    AccelerationLimit,
    Barrier,
    HalfPlane,
    SetTask,
    Stack,
    Task,
    ThrustLimit,
    VelocityBox,
    heading_task,
)
from surctl.testing import check_task


@pytest.mark.parametrize("n", [1, 3, 12])
def test_a_stack_of_any_width_is_solved_as_by_hand(n: int) -> None:
    q, S = ca.SX.sym("q", n), 2.0 * np.eye(n)
    stack = Stack((Task(name="joints", eta=q, sigma=q, target=0.5, kinematics=S),))
    nu = np.zeros(n)
    limits = [
        VelocityBox([-0.2] * n, [0.2] * n),
        ThrustLimit(nu, np.ones(n), load=nu, lower=[-9.0] * n, upper=[9.0] * n, dt=0.1),
        AccelerationLimit(nu, [9.0] * n, dt=0.1),
        HalfPlane("half", np.ones(n), 0.15 * n),
        Barrier("wall", q, h=0.2 - q[0], kinematics=S),
    ]
    assembly = assemble(stack, limits, inputs={"q": q})
    assert assembly.stack.velocities == n
    v = solve(assembly.problem({"q": nu}), backend="daqp").v
    # 2 v = 0.5 is out of the box; the wall allows 2 v[0] <= 0.2, and the half-plane the sum of all
    expected = np.full(n, min(0.2, (0.15 * n - 0.1) / max(1, n - 1)))
    expected[0] = 0.1
    np.testing.assert_allclose(v, expected, atol=1e-9)


def test_the_compiled_tick_is_as_wide_as_its_stack() -> None:
    q = ca.SX.sym("q", 2)
    stack = Stack((Task(name="sum", eta=q, sigma=ca.sum1(q), target=1.0),))
    assembly = assemble(stack, [VelocityBox([-0.2, -0.2], [0.2, 0.6])], inputs={"q": q})
    step = assembly.step()
    step.solve()
    np.testing.assert_allclose(step.v, [0.2, 0.6])


def test_widths_that_do_not_fit_are_refused() -> None:
    q, eta = ca.SX.sym("q", 3), ca.SX.sym("eta", 6)
    arm = Task(name="arm", eta=q, sigma=q[0])
    with pytest.raises(InputError, match=r"limit velocity\.0: a: has 2 entries, expected 3"):
        assemble(Stack((arm,)), [VelocityBox([-1, -1], [1, 1])], inputs={"q": q})
    with pytest.raises(InputError, match="task arm: kinematics: is not a matrix with a row per entry of eta"):
        Task(name="arm", eta=q, sigma=q[0], kinematics=np.eye(2))
    with pytest.raises(InputError, match="task two: has different kinematics from task arm"):
        Stack((arm, Task(name="two", eta=q, sigma=q[1], kinematics=np.ones((3, 2)))))
    with pytest.raises(InputError, match="task two: has different kinematics from task arm"):
        Stack((arm, Task(name="two", eta=q, sigma=q[1], kinematics=2 * np.eye(3))))
    joints = ca.SX.sym("q", 4)
    for make in (partial(Task, sigma=joints[3]), partial(SetTask, sigma=joints[3], lower=0.0, upper=1.0)):
        with pytest.raises(InputError, match="task wrist: kinematics: is missing, and eta has four entries; give"):
            make(name="wrist", eta=joints)
    with pytest.raises(InputError, match="limit wrist: kinematics: is missing, and eta has four entries; give"):
        Barrier("wrist", joints, h=joints[3])
    for eta_, word in ((q, "vehicle"), (joints, "vessel")):
        with pytest.raises(InputError, match=f"task wrist: kinematics = '{word}': is not known; give"):
            Task(name="wrist", eta=eta_, sigma=eta_[0], kinematics=word)
    sigma = ca.cos(joints[0]) + joints[3]
    free = Task(name="tool", eta=joints, sigma=sigma, kinematics=ca.SX.eye(4))
    body = Task(name="tool", eta=joints, sigma=sigma, kinematics="vehicle")
    at = ca.Function("at", [joints], [free.jacobian(), body.jacobian()])([0.5, 0, 0, 1.0])
    rate = -np.sin(0.5)
    np.testing.assert_allclose(at[0], [[rate, 0, 0, 1]])
    np.testing.assert_allclose(at[1], [[rate * np.cos(1.0), -rate * np.sin(1.0), 0, 1]])
    turned = Task(name="wrist", eta=joints, sigma=joints[3], target=0.4, kinematics=np.eye(4))
    assert check_task(turned).rank == 1  # no heading, so a full turn may change its reference
    with pytest.raises(InputError, match="task heading: eta: is not an SX symbol of shape"):
        heading_task(eta, 0.0)  # entry 3 of a pose in six degrees of freedom is roll
