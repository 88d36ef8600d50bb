"""URDF files for the tests: a drawn tree of links, and a small arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["ARM", "joint", "link", "written"]


def written(folder: Path, *parts: str, name: str = "robot.urdf") -> Path:
    path = folder / name
    path.write_text(f'<robot name="robot">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(
    name: str, parent: str, child: str, kind: str = "revolute", *, xyz: Sequence[float] = (0, 0, 0),
    rpy: Sequence[float] = (0, 0, 0), axis: Sequence[float] = (0, 0, 1), limit: str = "", more: str = "",
) -> str:  # fmt: skip
    numbers = [" ".join(map(repr, map(float, row))) for row in (xyz, rpy, axis)]
    bounds = f"<limit {limit}/>" if limit else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{numbers[0]}" rpy="{numbers[1]}"/><axis xyz="{numbers[2]}"/>{bounds}{more}</joint>'
    )


def _body(length: float) -> str:
    shape = f'<origin xyz="{length / 2} 0 0" rpy="0 1.5707963267948966 0"/>'
    shape += f'<geometry><cylinder radius="0.05" length="{length}"/></geometry>'
    return f"<inertial><mass value='1'/><origin xyz='{length / 2} 0 0'/></inertial><collision>{shape}</collision>"


_LIMIT = 'lower="-2.5" upper="2.5" velocity="2"'
ARM = (
    link("base", _body(0.1)),
    *(link(f"link{k}", _body(0.5)) for k in (1, 2, 3)),
    joint("shoulder", "base", "link1", limit=_LIMIT),
    joint("elbow", "link1", "link2", xyz=(0.5, 0, 0), limit=_LIMIT),
    joint("wrist", "link2", "link3", xyz=(0.5, 0, 0), limit=_LIMIT),
)
"""An arm with three joints in the plane z = 0, and links of 0.5 m."""
