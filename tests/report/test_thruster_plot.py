"""The plot of the forces that thrusters can produce."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from surctl.errors import InputError
from surctl.marine.report import plot_attainable
from surctl.marine.vehicle import attainable, load_vehicle
from tests.pictures import rendered


@pytest.mark.parametrize(("name", "failed"), [("bluerov2-heavy", ()), ("bluerov2-heavy", ("T2",)), ("sur540-jets", ())])
def test_every_corner_of_the_plot_is_on_the_edge_of_the_attainable_set(name: str, failed: tuple[str, ...]) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.actuators is not None
    ax = plot_attainable(vehicle, failed=failed)
    rendered(ax)
    forces, working = attainable(vehicle.actuators), [one.name not in failed for one in vehicle.actuators.thrusters]
    for line in ax.lines:
        yaw = float(str(line.get_label()).split()[2])
        for u, v in zip(*line.get_data(), strict=True):
            inner, outer = (np.array([u, v, 0.0, yaw]) * factor for factor in (0.99, 1.01))
            assert forces.contains(inner, working=working, tolerance=1e-2)
            assert not forces.contains(outer, working=working, tolerance=1e-4)


def test_a_vehicle_without_thrusters_is_refused() -> None:
    with pytest.raises(InputError, match="describes no thrusters"):
        plot_attainable(load_vehicle("sur400"))


def test_the_box_of_a_craft_that_is_weaker_astern_ends_at_both_limits() -> None:
    (box,) = (patch for patch in plot_attainable(load_vehicle("otter")).patches if isinstance(patch, Rectangle))
    assert (box.get_x(), box.get_x() + box.get_width()) == pytest.approx((-133.416, 239.364))


def test_a_craft_without_sway_force_is_plotted_in_surge_and_yaw() -> None:
    for name, half in (("otter", 52.6993), ("remus100", 1.4599 / 4)):
        ax = plot_attainable(load_vehicle(name))
        assert ax.get_ylabel() == "yaw moment F_r [N m]"
        forces, moments = ax.lines[-1].get_data()
        at_rest = np.abs(np.asarray(moments))[np.abs(forces) < 60]
        assert np.max(moments) >= half * (1 - 1e-3) and (
            name == "otter" or at_rest.max() == pytest.approx(half, rel=1e-3)
        )
