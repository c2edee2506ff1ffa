"""Errors in robots and blocks: one line, exit code 2, no traceback, and no file written."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from commands import run_command
from robots import DATA, ur5_path

from freeflyer_fmus.robot.urdf import ROBOTS as SHIPPED_ROBOTS


def urdf(tmp_path: Path, *changes: tuple[str, str]) -> str:
    text = (DATA / "gantry.urdf").read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return str(path)


GANTRY = ("--end-effector", "hand", "--lock", "swivel=0.4")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("<robot", "<robt")], "not well-formed XML"),
        ([('<mass value="60"/>', '<mass value="-60"/>')], "link 'bus': mass is -60 kg"),
        (
            [('ixx="8" iyy="9" izz="7"', 'ixx="1" iyy="9" izz="7"')],
            "link 'bus': inertia violates the triangle inequality; its principal moments are (",
        ),
        (
            [('ixx="8" iyy="9" izz="7"', 'ixx="-8" iyy="9" izz="7"')],
            "link 'bus': inertia is not positive definite; its principal moments are (",
        ),
        (
            [('<mass value="60"/>', '<mass value="heavy"/>')],
            "link 'bus' has value='heavy'; a number is expected",
        ),
        (
            [('<parent link="boom"/>', '<parent link="bom"/>')],
            "joint 'turn_1' has parent link 'bom', which does not exist; did you mean 'boom'",
        ),
        (
            [('name="antenna_mount" type="fixed"', 'name="antenna_mount" type="revolute"')],
            "not a serial chain: joint 'antenna_mount' moves a branch",
        ),
        (
            [('name="turn_2" type="revolute"', 'name="turn_2" type="planar"')],
            "joint 'turn_2' is of type 'planar'",
        ),
        ([('xyz="0 -1 0.3"', 'xyz="0 0 0"')], "joint 'turn_2' has an axis of zero length"),
        ([('xyz="0 -1 0.3"', 'xyz="0 -1"')], "three finite numbers are expected"),
        (
            [('<child link="hand"/>', '<child link="palm"/>')],
            "not a tree: link 'palm' is the child of both joints",
        ),
        ([('<link name="hand"/>', '<link name="bus"/>')], "link 'bus' is defined twice"),
    ],
)
def test_an_invalid_urdf_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, changes: list[tuple[str, str]], message: str
) -> None:
    code, error = run_command(
        capsys, "fmus", "--robot", urdf(tmp_path, *changes), *GANTRY, "--out", str(tmp_path / "out")
    )
    assert message in error
    assert code == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--end-effector", "hnad"), "end-effector 'hnad' does not exist; did you mean 'hand'"),
        (
            ("--end-effector", "hand", "--base-link", "bsu"),
            "base link 'bsu' does not exist; did you mean 'bus'",
        ),
        (
            ("--end-effector", "hand", "--lock", "swivl=0"),
            "locked joint 'swivl' does not exist; did you mean 'swivel'",
        ),
        (("--end-effector", "hand", "--lock", "swivel"), "JOINT=VALUE with a number is expected"),
        (
            (*GANTRY, "--lock", "turn_4=0"),
            "needs at least six free joints so that the end-effector can move in all directions, got 5",
        ),
        (
            (*GANTRY, "--posture", "1", "2"),
            "posture has 2 values; 6 values are expected, one for each free joint",
        ),
        (
            (
                *GANTRY,
                "--posture",
                "slide_x=9",
                "slide_y=0",
                "turn_1=0",
                "turn_2=0",
                "turn_3=0",
                "turn_4=0",
            ),
            "outside the joint's limits [-0.5, 0.5]",
        ),
        ((*GANTRY, "--posture", "slide_x=0"), "posture lacks the joints slide_y"),
        ((*GANTRY, "--posture", "-1e-05", "-.5E3"), "posture has 2 values; 6 values are expected"),
        (("--lock", "="), "for example JOINT=0.5"),
        (
            (*GANTRY, "--tool-link", "antenna"),
            "tool link 'antenna' must have an <inertial> and be between",
        ),
        ((*GANTRY, "--platforms", "amiga"), "'amiga' is not one of"),
        (("--end-effector", "antenna"), "not a serial chain: joint 'slide_x' moves a branch"),
        (
            ("--base-link", "palm", "--end-effector", "hand"),
            "have mass but are not below the base link 'palm'",
        ),
    ],
)
def test_invalid_options_of_fmus_are_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    code, error = run_command(
        capsys,
        "fmus",
        "--robot",
        str(DATA / "gantry.urdf"),
        *options,
        "--out",
        str(tmp_path / "out"),
    )
    assert message in error
    assert code == 2


def test_a_singular_start_posture_is_rejected_before_the_build(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = (
        "fmus",
        "--robot",
        str(ur5_path()),
        "--base-link",
        "base_link",
        "--end-effector",
        "tool0",
        "--out",
        str(tmp_path / "out"),
    )
    code, error = run_command(capsys, *arguments)
    assert code == 2
    assert "at the start posture the smallest singular value of J_m is" in error
    assert "give another start posture with --posture" in error
    assert not (tmp_path / "out").exists()


def test_an_invalid_robot_file_or_a_missing_urdf_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text('urdf = "x.urdf"\nend_efector = "hand"\n')
    assert (
        "unknown key 'end_efector'; did you mean 'end_effector'"
        in run_command(capsys, "fmus", "--robot", str(robot))[1]
    )
    assert (
        "cannot be read: No such file"
        in run_command(capsys, "fmus", "--robot", str(tmp_path / "none.urdf"))[1]
    )
    assert "apply only to a URDF" in run_command(capsys, "fmus", "--end-effector", "hand")[1]
    shutil.copy(SHIPPED_ROBOTS / "lwr4_free_flyer.urdf", tmp_path)
    robot.write_text('urdf = "lwr4_free_flyer.urdf"\nposture = [0, 0.1, -1.6, 0, -1.4, 0]\n')
    assert (
        "posture has 6 values; 7 values are expected, one for each free joint: joint_a1, joint_a2, joint_e1"
        in run_command(capsys, "fmus", "--robot", str(robot))[1]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "does not define block(robot)"),
        ("1/0\n", "ZeroDivisionError"),
        ("def block(robot):\n    return {}['k']\n", "block(robot) failed: KeyError"),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    return Block('größe', '')\n",
            "must be an identifier",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    b.input('time', 0.0, 'm', '')\n",
            "the reserved name 'time'",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    b.input('x', 0.0, 'furlong', '')\n",
            "the unit 'furlong', which is unknown",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    b.parameter('x', -1.0, 'm', '', above=0.0)\n",
            "which violates its bound 0",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    return Block('b', '')\n",
            "neither outputs nor states",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    x = b.state('x', 0.0, 'm', '')\n    b.update('x', x)\n    return b\n",
            "it is continuous, so `update` is not applicable",
        ),
        ("def block(robot):\n    return 5\n", "block(robot) returned a int; a Block is expected"),
        ("def block(:\n", "does not define block(robot)"),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    b.state('x', 0.0, 'm', '')\n    return b\n",
            "no equation for the states x",
        ),
        (
            "from freeflyer_fmus.blocks.block import Block\ndef block(robot):\n    b = Block('b', '')\n    b.parameter('x', 0.0, 'm', '')\n    b.parameter('x', 0.0, 'm', '')\n",
            "declared twice",
        ),
    ],
)
def test_an_invalid_block_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    code, error = run_command(capsys, "fmus", "--block", str(path), "--out", str(tmp_path / "out"))
    assert message in error
    assert code == 2
