"""URDF files: each mistake gives one line with the file, the element and a remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from surctl.errors import InputError
from surctl.robot import load_urdf, read_urdf
from tests.robot.robots import ARM, joint, link, written

AB = link("a") + link("b")
BALL = "<collision><geometry><{}/></geometry></collision>"


def _hinge(**arguments: Any) -> str:
    return AB + joint("j", "a", "b", **arguments)


BAD = {
    "link: has no name": "<link/>",
    "has no link": "",
    "contains xacro macros": "<xacro:arm/>",
    "is the name of two links": link("a") + link("a"),
    "is the name of two joints": _hinge() + link("c") + joint("j", "a", "c"),
    "did you mean 'abc'": link("abc") + link("b") + joint("j", "abd", "b"),
    "has 2 root links: a, b": AB,
    "is the child of joints i and j": AB + joint("i", "a", "b") + joint("j", "a", "b"),
    "has a cycle of links: a → b": AB + joint("i", "a", "b") + joint("j", "b", "a"),
    "has a cycle of links: b": AB + joint("j", "b", "b"),
    "joint j: type = 'hinge': is not a joint type": _hinge(kind="hinge"),
    "joint j: has no child link": '<joint name="j" type="fixed"><parent link="a"/></joint>',
    "joint j: limit lower = 'nan'": _hinge(limit='lower="nan"'),
    "joint j: limit velocity = '2 m'": _hinge(limit='velocity="2 m"'),
    "joint j: limit velocity = -2.0": _hinge(limit='velocity="-2"'),
    "joint j: limits = [1.0, 0.0]": _hinge(limit='lower="1" upper="0"'),
    "joint j: axis = [0.0, 0.0, 0.0]": _hinge(axis=(0, 0, 0)),
    "of a planar joint is not z": _hinge(kind="planar", axis=(1, 0, 0)),
    "joint j: origin: xyz = '0.0 0.0 inf'": _hinge(xyz=(0, 0, float("inf"))),
    "joint j: mimic = 'k': no such joint": _hinge(more='<mimic joint="k"/>'),
    "leads back to the joint itself": _hinge(more='<mimic joint="j"/>'),
    "is planar, so it cannot mimic a joint": _hinge(kind="planar", more='<mimic joint="j"/>'),
    "link a: mass = -1.0": link("a", '<inertial><mass value="-1"/></inertial>'),
    "link a: inertia = -1.0: is negative": link("a", '<inertial><inertia ixx="-1"/></inertial>'),
    "link a: inertia: ixy = 'nan'": link("a", '<inertial><inertia ixy="nan"/></inertial>'),
    "joint j: has 2 elements <limit>": _hinge(limit='lower="-1"', more='<limit upper="1"/>'),
    "joint j: has 2 elements <parent>": _hinge(more='<parent link="b"/>'),
    "joint j = [-1.0, 1.0]: is continuous, but has limits": _hinge(
        kind="continuous", limit='lower="-1" upper="1" velocity="1"'
    ),
    "'${-pi}': is not a number; expand the file with xacro": _hinge(limit='lower="${-pi}"'),
    "link a: collision: has no geometry": link("a", "<collision/>"),
    "link a: geometry = 'ball'": link("a", BALL.format("ball")),
    "has a size that is not positive": link("a", BALL.format('sphere radius="0"')),
}
TEXTS = {
    "is not XML": "<robot><link name='a'></robot>",
    "declares a document type": '<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
    "begins with <sdf>": "<sdf/>",
    "is not XML (unknown encoding: klingon)": "<?xml version='1.0' encoding='klingon'?><robot/>",
} | {problem: f"<robot>{inside}</robot>" for problem, inside in BAD.items()}


@pytest.mark.parametrize("problem", TEXTS)
def test_a_mistake_in_the_file_gives_one_line(problem: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.urdf"
    path.write_text(TEXTS[problem], encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_urdf(path)
    text = str(caught.value)
    assert problem in text and text.startswith(f"{path}: ") and "\n" not in text


def test_a_file_that_is_absent_huge_or_not_text_gives_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_urdf(tmp_path / "absent.urdf")
    for path in (tmp_path, Path("/dev/zero")):
        with pytest.raises(InputError, match="is not a file"):
            read_urdf(path)
    huge = tmp_path / "huge.urdf"
    with huge.open("wb") as file:
        file.truncate(30_000_000)
    with pytest.raises(InputError, match="is larger than 20 MB"):
        read_urdf(huge)
    (tmp_path / "picture.urdf").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="is not XML"):
        read_urdf(tmp_path / "picture.urdf")


@pytest.mark.parametrize("encoding", ["utf-16", "iso-8859-1", "cp1252"])
def test_other_encodings_and_names_with_quotes_are_read(encoding: str, tmp_path: Path) -> None:
    name = "l'été &quot;1&quot;"
    inside = link("a") + link(name) + joint("ü", "a", name)
    text = f'<?xml version="1.0" encoding="{encoding}"?><robot>{inside}</robot>'
    (tmp_path / "named.urdf").write_bytes(text.encode(encoding))
    robot = load_urdf(tmp_path / "named.urdf")
    assert robot.links == ("a", 'l\'été "1"') and robot.names == ("ü",)
    with pytest.raises(InputError, match="is not the name of a link") as caught:
        robot.frame("l'ete")
    assert "l'été" in str(caught.value)


def test_a_mistake_in_the_arguments_gives_one_line(tmp_path: Path) -> None:
    path = written(tmp_path, *ARM)
    for arguments, problem in (
        ({"lock": ["elbwo"]}, "did you mean 'elbow'"),
        ({"lock": {"elbow": float("nan")}}, "cannot be locked there"),
        ({"lock": ["shoulder", "elbow", "wrist"]}, "has no joint that moves"),
        ({"base": "wheels"}, "base = 'wheels'"),
    ):
        with pytest.raises(InputError) as caught:
            load_urdf(path, **arguments)
        assert problem in str(caught.value) and "\n" not in str(caught.value)


def test_elements_of_other_namespaces_are_no_urdf(tmp_path: Path) -> None:
    foreign = '<ext:axis xyz="0 1 0"/><drake:limit lower="-1" upper="1"/><ext:mimic joint="j"/>'
    more = '<viz:link name="a"/><drake:joint name="d" type="universal"/>'
    urdf = read_urdf(written(tmp_path, AB, more, joint("j", "a", "b", more=foreign)))
    assert repr(urdf) == repr(read_urdf(written(tmp_path, AB, joint("j", "a", "b"))))


def test_a_shape_inside_another_is_left_out(tmp_path: Path) -> None:
    ends = "".join(
        f'<collision><origin xyz="0 0 {z}"/><geometry><sphere radius="{r}"/></geometry></collision>'
        for z, r in ((0.2, 0.1), (-0.2, 0.1), (0.2, 0.11))
    )
    tube = BALL.format('cylinder radius="0.1" length="0.4"')
    urdf = read_urdf(written(tmp_path, link("a", ends + tube + tube)))
    assert [(shape.radius, shape.length) for shape in urdf.links["a"].shapes] == [(0.11, 0.0), (0.1, 0.4)]


def test_the_limits_of_mimicking_joints_bound_the_joint_that_they_follow(tmp_path: Path) -> None:
    mimic = '<mimic joint="j" multiplier="-2" offset="1"/>'
    follower = joint("f", "a", "c", limit='lower="-1" upper="3" velocity="1"', more=mimic)
    first = joint("j", "a", "b", limit='lower="-4" upper="4" velocity="2"')
    robot = load_urdf(written(tmp_path, AB, link("c"), first, follower))
    [place] = robot.coordinates
    assert robot.range_of(place) == (-1.0, 1.0)  # -1 <= 1 - 2 q <= 3
    assert robot.speed_of(place, {}) == 0.5
