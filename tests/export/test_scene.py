"""The scene: the geometry of a robot for viewers, in the FMUs of blocks with a robot."""

from __future__ import annotations

import base64
import dataclasses
import importlib
import json
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from families import alternating, family
from instances import Instance
from robots import DATA, FOREIGN, example
from scipy.spatial.transform import Rotation

from freeflyer.cli import main as command
from freeflyer.foundation.equal_inertia_box import equal_inertia_box
from freeflyer.foundation.extras import EXTRAS
from freeflyer_fmus import Robot, RobotError, load_robot, robot_scene
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.export import mesh
from freeflyer_fmus.export.archive import content_token
from freeflyer_fmus.export.scene import SCENE, scene, scene_json
from freeflyer_fmus.robot.urdf import ROBOTS as SHIPPED
from freeflyer_fmus.robot.urdf_visuals import MOST_NOTES, MOST_VISUALS
from freeflyer_fmus.robot.visual import Appearance

ROOT = Path(__file__).parents[2]
Scene = dict[str, Any]
WITH_ROBOT = ("free_flyer", "satellite", "arm_drive", "hand_kinematics")
TOLERANCE = 1e-9


GANTRY = {"end_effector": "hand", "tool_link": "gripper", "lock": {"swivel": 0.4}}
SHIPPED_OPTIONS = {"base_link": "base", "end_effector": "end_effector", "lock": {"joint_e1": 0.3}}


def source(name: str) -> tuple[Path, dict[str, Any]]:
    if name == "gantry":
        return DATA / "gantry.urdf", GANTRY
    if name == "lwr4":
        return SHIPPED / "lwr4_free_flyer.urdf", SHIPPED_OPTIONS
    file, options = FOREIGN[name]
    return example(file), options


def without_shapes(robot: Robot) -> Robot:
    look = dataclasses.replace(robot.appearance, visuals=())
    return dataclasses.replace(robot, appearance=look)


# Forward kinematics, from the scene alone.


def matrix(pose: Scene) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(pose["orientation"]).as_matrix()
    T[:3, 3] = pose["position"]
    return T


def frames(shown: Scene, base: np.ndarray, q: np.ndarray) -> list[np.ndarray]:
    """Return the poses (4, 4) of B, of the joint frames, and of E, for the pose `base` of B."""
    poses = [base]
    for joint, value in zip(shown["joints"], q, strict=True):
        moved = np.eye(4)
        if joint["kind"] == "revolute":
            moved[:3, :3] = Rotation.from_rotvec([0.0, 0.0, value]).as_matrix()
        else:
            moved[2, 3] = value
        poses.append(poses[-1] @ matrix(joint) @ moved)
    return [*poses, poses[-1] @ matrix(shown["end_effector"])]


@pytest.mark.parametrize(("version", "name"), alternating(("fmi2", "fmi3"), WITH_ROBOT[::3]))
def test_the_scene_of_an_fmu_has_the_forward_kinematics_of_this_fmu(
    fmus: Path, version: str, name: str
) -> None:
    path = fmus / version / f"{name}.fmu"
    with zipfile.ZipFile(path) as archive:
        shown = json.loads(archive.read(SCENE))
    random = np.random.default_rng(7)
    for _ in range(5):
        position, q = random.normal(size=3), random.uniform(-2.0, 2.0, size=6)
        orientation = Rotation.random(rng=random)
        fmu = Instance(path)
        fmu.enter()
        for variable, value in (
            ("base_position", position),
            ("base_orientation", orientation.as_quat()),
            ("joint_position", q),
        ):
            fmu.set(variable, value)
        fmu.fmu.exitInitializationMode()
        if name == "hand_kinematics":
            fmu.step(0.0, 1e-3)
        base = matrix({"position": position, "orientation": orientation.as_quat()})
        end = frames(shown, base, q)[-1]
        assert np.abs(end[:3, 3] - fmu.get("end_effector_position")).max() < TOLERANCE
        found = Rotation.from_quat(fmu.get("end_effector_orientation")).as_matrix()
        assert np.abs(end[:3, :3] - found).max() < TOLERANCE


class Peer:
    """Pinocchio's model of a URDF. All poses are in B."""

    def __init__(self, path: Path, options: dict[str, Any], q: dict[str, float]) -> None:
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.configuration = pin.neutral(self.model)
        for name, value in (q | options.get("lock", {})).items():
            joint = self.model.joints[self.model.getJointId(name)]
            if joint.nq == 2:  # a continuous joint
                self.configuration[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                self.configuration[joint.idx_q] = value
        pin.framesForwardKinematics(self.model, self.data, self.configuration)
        pin.computeJointJacobians(self.model, self.data)
        base = options.get("base_link", self.model.frames[1].name)
        robot = load_robot(path, **options)
        self.base = self.link(base) * pin.SE3(np.eye(3), centre_of_mass(path, base))
        self.robot = robot

    def link(self, name: str) -> Any:
        return self.data.oMf[self.model.getFrameId(name, pin.FrameType.BODY)]

    def in_base(self, pose: Any) -> np.ndarray:
        return np.array(self.base.actInv(pose).homogeneous)

    def joint(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the origin of a joint, and its axis."""
        number = self.model.getJointId(name)
        column = pin.getJointJacobian(
            self.model, self.data, number, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:, self.model.joints[number].idx_v]
        axis = column[3:] if np.abs(column[3:]).max() > 0.5 else column[:3]
        return self.in_base(self.data.oMi[number])[:3, 3], self.base.rotation.T @ axis


def centre_of_mass(path: Path, link: str) -> np.ndarray:
    root = ElementTree.parse(path).getroot()
    origin = root.find(f"link[@name='{link}']/inertial/origin")
    return np.array([float(x) for x in (origin.get("xyz", "0 0 0").split())])


def posture(robot: Robot, seed: int) -> dict[str, float]:
    random = np.random.default_rng(seed)
    return {joint.name: float(random.uniform(-1.5, 1.5)) for joint in robot.joints}


@pytest.mark.parametrize("name", [*FOREIGN, "gantry", "lwr4"])
def test_every_frame_of_the_scene_is_where_pinocchio_has_it(name: str) -> None:
    path, options = source(name)
    robot = load_robot(path, **options)
    shown = scene(without_shapes(robot))
    for seed in range(3):
        q = posture(robot, seed)
        peer = Peer(path, options, q)
        found = frames(shown, np.eye(4), np.array(list(q.values())))
        for joint, pose in zip(shown["joints"], found[1:-1], strict=True):
            origin, axis = peer.joint(joint["name"])
            assert np.abs(pose[:3, 3] - origin).max() < TOLERANCE
            assert np.abs(pose[:3, 2] - axis).max() < TOLERANCE
        tip = options.get("end_effector", "link_eef" if name == "xarm7" else "gripperMover")
        assert np.abs(found[-1] - peer.in_base(peer.link(tip))).max() < TOLERANCE


@pytest.mark.parametrize("name", family(["ur5", "lwr4", *[n for n in FOREIGN if n != "ur5"]], 2))
def test_every_shape_is_where_pinocchio_draws_it(name: str) -> None:
    path, options = source(name)
    robot = load_robot(path, **options)
    shown = scene(robot)
    assert (shown["drawn"], shown["notes"]) == ("urdf", [])
    q = posture(robot, 5)
    peer = Peer(path, options, q)
    packages = [str(folder) for folder in path.parents]
    model = pin.buildGeomFromUrdf(
        peer.model, str(path), pin.GeometryType.VISUAL, package_dirs=packages
    )
    data = model.createData()
    pin.updateGeometryPlacements(peer.model, peer.data, model, data, peer.configuration)
    expected: dict[str, list[np.ndarray]] = {}
    for pose, geometry in zip(data.oMg, model.geometryObjects, strict=True):
        link = peer.model.frames[geometry.parentFrame].name
        expected.setdefault(link, []).append(peer.in_base(pose))
    poses = frames(shown, np.eye(4), np.array(list(q.values())))
    drawn: dict[str, list[np.ndarray]] = {}
    for visual in shown["visuals"]:
        drawn.setdefault(visual["name"], []).append(poses[visual["frame"]] @ matrix(visual))
    expected.pop("world", None)
    assert drawn.keys() == expected.keys()
    for link, own in drawn.items():
        for one, other in ((own, expected[link]), (expected[link], own)):
            for pose in one:
                assert min(np.abs(pose - each).max() for each in other) < TOLERANCE, link


def test_bodies_locks_and_mount_are_those_of_the_robot() -> None:
    robot = load_robot()
    shown = robot_scene()
    assert [(body["frame"], body["name"]) for body in shown["bodies"]] == [
        (0, "base"),
        (0, "base_attachment"),
        *((k, joint.name) for k, joint in enumerate(robot.joints, 1)),
        (7, "tool"),
    ]
    assert shown["bodies"][0]["inertia"] == [38.0, 20.0, 23.0, 0.0, 0.0, 0.0]
    total = sum(body["mass"] for body in shown["bodies"])
    assert total == pytest.approx(150.0 + 16.0 + 1.2, abs=1e-9)
    assert shown["locked"] == [{"name": "joint_e1", "position": 0.0}]
    assert shown["mount"] == {"position": [0.0, 0.0, 0.35], "orientation": [0.0, 0.0, 0.0, 1.0]}
    assert shown["joints"][0]["upper"] == pytest.approx(robot.joints[0].upper)
    gantry = scene(load_robot(DATA / "gantry.urdf", **GANTRY))
    assert {joint["kind"] for joint in gantry["joints"]} == {"revolute", "prismatic"}
    assert None in [joint["lower"] for joint in gantry["joints"]]


# The FMUs.


def test_the_fmus_of_blocks_with_a_robot_contain_its_scene(fmus: Path, robot: Robot) -> None:
    for path in fmus.glob("*/*.fmu"):
        with zipfile.ZipFile(path) as archive:
            if path.stem in WITH_ROBOT:
                assert archive.read(SCENE) == scene_json(robot), path
            else:
                assert SCENE not in archive.namelist(), path


@pytest.mark.parametrize("name", ["free_flyer", "hand_kinematics"])
def test_the_token_does_not_depend_on_the_shapes(robot: Robot, name: str) -> None:
    plain = dataclasses.replace(robot, appearance=Appearance())
    assert scene_json(plain) != scene_json(robot)
    assert content_token(BLOCKS[name](plain)) == content_token(BLOCKS[name](robot))


def test_the_shipped_scene_needs_no_package_of_an_extra() -> None:
    hidden = "; ".join(f"sys.modules[{name!r}] = None" for name in EXTRAS["export"])
    shown = "import json; from freeflyer_fmus import robot_scene; print(json.dumps(robot_scene()))"
    code = f"import sys; {hidden}; {shown}"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, check=True)
    shown = json.loads(done.stdout)
    assert shown["drawn"] == "urdf"
    assert {visual["shape"] for visual in shown["visuals"]} == {"box", "cylinder", "sphere"}


def test_the_readers_of_the_viewer_read_a_urdf_and_a_robot_file() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    readers = project["entry-points"]["freeflyer.view_readers"]
    assert readers.keys() >= {"urdf", "toml"}
    for suffix, options in (("toml", {}), ("urdf", SHIPPED_OPTIONS | {"lock": {"joint_e1": 0.0}})):
        module, name = readers[suffix].split(":")
        read = getattr(importlib.import_module(module), name)
        found = read(SHIPPED / f"lwr4_free_flyer.{suffix}", options)["scene"]
        assert found["visuals"] == robot_scene()["visuals"]


def test_the_fmu_of_a_users_block_has_the_scene_and_the_command_prints_the_notes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = urdf_with(tmp_path, visual('<mesh filename="none.stl"/>') + GOOD)
    (tmp_path / "plant.py").write_text(
        "from freeflyer_fmus import Block\n\n"
        "def block(robot):\n"
        "    b = Block('plant', '')\n"
        "    b.robot = robot\n"
        "    b.sampled_every('period', 0.01, 'Sampling time')\n"
        "    b.output('twice', 2.0 * b.input('x', 0.0, 'm', 'Input'), 'm', 'Output')\n"
        "    return b\n"
    )
    arguments = ["--robot", robot, "--end-effector", "hand", "--lock", "swivel=0.4"]
    arguments += ["--block", tmp_path / "plant.py", "--platforms", "sources", "--out", tmp_path]
    assert command.call(["fmus", *map(str, arguments)]) == 0
    printed = capsys.readouterr().out
    assert f"note: mesh {tmp_path / 'none.stl'} cannot be read: No such file" in printed
    for version in ("fmi2", "fmi3"):
        with zipfile.ZipFile(tmp_path / version / "plant.fmu") as archive:
            shown = json.loads(archive.read(SCENE))
        assert [visual["shape"] for visual in shown["visuals"]] == ["sphere"]


# Robots without shapes.


def test_a_robot_without_shapes_is_drawn_from_joints_and_inertia() -> None:
    shown = scene(load_robot(DATA / "gantry.urdf", **GANTRY))
    assert (shown["drawn"], shown["notes"]) == ("inertia", [])
    base, *rest = shown["visuals"]
    assert base["shape"] == "box"
    assert base["color"][3] < 1.0, "the base must not hide the arm"
    assert {visual["shape"] for visual in rest} == {"capsule", "cylinder", "box"}
    assert rest[-1]["name"] == "tool"
    # The capsule of each frame ends at the next origin.
    for visual in (visual for visual in rest if visual["shape"] == "capsule"):
        T, k = matrix(visual), visual["frame"]
        following = [*shown["joints"], shown["end_effector"]][k]["position"]
        end = T[:3, 3] + 0.5 * visual["length"] * T[:3, 2]
        assert np.abs(end - following).max() < 1e-9


def test_the_box_of_equal_inertia_has_the_inertia_of_the_body() -> None:
    random = np.random.default_rng(2)
    for _ in range(20):
        a, b, c = random.uniform(0.2, 2.0, size=3)
        R, mass = Rotation.random(rng=random).as_matrix(), random.uniform(1.0, 200.0)
        solid = R @ np.diag([b * b + c * c, c * c + a * a, a * a + b * b]) @ R.T * mass / 12.0
        entries = [solid[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        edges, orientation = equal_inertia_box(mass, entries)
        assert sorted(edges) == pytest.approx(sorted((a, b, c)), rel=1e-9)
        x, y, z = np.square(edges)
        Q = Rotation.from_quat(orientation).as_matrix()
        again = Q @ np.diag([y + z, z + x, x + y]) @ Q.T * mass / 12.0
        assert np.abs(again - solid).max() < 1e-9 * mass


def test_the_box_of_an_aligned_body_is_not_turned() -> None:
    edges, orientation = equal_inertia_box(150.0, [38.0, 20.0, 23.0, 0.0, 0.0, 0.0])
    assert edges == pytest.approx(np.sqrt(np.array([5.0, 41.0, 35.0]) / 25.0))
    assert orientation == pytest.approx((0.0, 0.0, 0.0, 1.0))
    flat, _ = equal_inertia_box(1.0, [1.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    assert min(flat) > 0.0


# Shapes that cannot be drawn.


def urdf_with(tmp_path: Path, visuals: str, materials: str = "") -> Path:
    """Write the gantry with <visual> elements of its base. Return the path of the file."""
    text = (DATA / "gantry.urdf").read_text()
    assert '<link name="bus">' in text
    text = text.replace('<link name="bus">', f'{materials}<link name="bus">{visuals}')
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


def visual(shape: str, more: str = "") -> str:
    return f"<visual><geometry>{shape}</geometry>{more}</visual>"


GOOD = visual('<sphere radius="0.2"/>')
INVALID = {
    "NaN": (visual('<box size="1 nan 1"/>'), "three finite numbers are expected"),
    "negative": (visual('<box size="1 -1 1"/>'), "greater than zero"),
    "zero": (visual('<cylinder radius="0" length="1"/>'), "greater than zero"),
    "huge": (visual('<sphere radius="1e300"/>'), "at most 10000"),
    "infinite": (visual('<sphere radius="inf"/>'), "at most 10000"),
    "words": (visual('<box size="big"/>'), "three finite numbers are expected"),
    "no size": (visual("<box/>"), "three finite numbers are expected"),
    "no radius": (visual("<sphere/>"), "a number is expected"),
    "no shape": (visual(""), "one shape is expected"),
    "no geometry": ("<visual/>", "one shape is expected"),
    "two shapes": (visual('<box size="1 1 1"/><box size="1 1 1"/>'), "one shape is expected"),
    "unknown": (visual('<teapot size="1"/>'), "box, sphere, cylinder, capsule or mesh"),
    "far": (visual('<box size="1 1 1"/>', '<origin xyz="1e9 0 0"/>'), "more than 10000 m"),
    "color": (
        visual('<box size="1 1 1"/>', '<material name=""><color rgba="1 2 3 4"/></material>'),
        "four numbers from 0 to 1",
    ),
    "mesh scale": (visual('<mesh filename="a.stl" scale="0 1 1"/>'), "greater than zero"),
    "mesh name": (visual("<mesh/>"), "without a file name"),
    "package": (visual('<mesh filename="package://none/a.stl"/>'), "ROS_PACKAGE_PATH"),
    "no file": (visual('<mesh filename="none.stl"/>'), "No such file or directory"),
    "folder": (visual('<mesh filename="."/>'), "cannot be read"),
}


@pytest.mark.parametrize("case", INVALID)
def test_an_invalid_shape_is_a_note_and_the_rest_is_drawn(tmp_path: Path, case: str) -> None:
    text, reason = INVALID[case]
    shown = robot_scene(urdf_with(tmp_path, text + GOOD), **GANTRY)
    assert [visual["shape"] for visual in shown["visuals"]] == ["sphere"]
    (note,) = shown["notes"]
    assert reason in note
    assert note.endswith("is not drawn")
    assert "\n" not in note


def test_a_robot_with_invalid_shapes_only_is_drawn_from_its_inertia(tmp_path: Path) -> None:
    shown = robot_scene(urdf_with(tmp_path, INVALID["NaN"][0]), **GANTRY)
    assert shown["drawn"] == "inertia"
    assert len(shown["notes"]) == 1


def test_the_number_of_shapes_and_notes_is_limited(tmp_path: Path) -> None:
    shown = robot_scene(urdf_with(tmp_path, GOOD * (MOST_VISUALS + 500)), **GANTRY)
    assert len(shown["visuals"]) == MOST_VISUALS
    assert f"has {MOST_VISUALS + 500} visuals; only the first {MOST_VISUALS}" in shown["notes"][0]
    with pytest.raises(RobotError, match=r"cannot be read: it has more than 16 MiB"):
        robot_scene(urdf_with(tmp_path, GOOD * 300_000))
    shown = robot_scene(urdf_with(tmp_path, INVALID["NaN"][0] * 500 + GOOD), **GANTRY)
    assert len(shown["notes"]) == MOST_NOTES + 1
    assert "495 other shapes" in shown["notes"][-1]


def test_colors_are_those_of_the_materials(tmp_path: Path) -> None:
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    own = '<material name="own"><color rgba="0 1 0 0.5"/></material>'
    named = '<material name="red"/>'
    later = '<material name="own"/>'
    ball = '<sphere radius="0.2"/>'
    text = "".join(visual(ball, more) for more in (named, own, later, ""))
    shown = robot_scene(urdf_with(tmp_path, text, red), **GANTRY)
    colors = [visual["color"] for visual in shown["visuals"]]
    assert colors[:3] == [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5]]


# Meshes.


def stl(path: Path, triangles: np.ndarray) -> Path:
    """Write a binary STL file of `triangles` (n, 3, 3) [m]."""
    rows = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = triangles
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + rows.tobytes())
    return path


def sphere(n: int) -> np.ndarray:
    """Return about 4 n^2 triangles (.., 3, 3) of a sphere of radius 1 m."""
    polar, around = np.meshgrid(
        np.linspace(0.0, np.pi, n + 1), np.linspace(0.0, 2.0 * np.pi, 2 * n + 1), indexing="ij"
    )
    p = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], 2)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate([np.stack(t, 2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


def decoded(visual: Scene) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.frombuffer(base64.b64decode(visual["vertices"]), "<f4").reshape(-1, 3)
    triangles = np.frombuffer(base64.b64decode(visual["triangles"]), "<u4").reshape(-1, 3)
    return vertices.astype(float), triangles.astype(int)


def mesh_scene(tmp_path: Path, shape: str) -> Scene:
    return robot_scene(urdf_with(tmp_path, visual(shape) + GOOD), **GANTRY)


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume [m3] inside a closed surface. It is negative if the backs are outside."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def test_a_large_mesh_is_reduced_to_nearly_the_same_surface(tmp_path: Path) -> None:
    stl(tmp_path / "ball.stl", sphere(60))
    shown = mesh_scene(tmp_path, '<mesh filename="ball.stl" scale="0.5 0.5 0.5"/>')
    vertices, triangles = decoded(shown["visuals"][0])
    assert shown["notes"] == []
    assert 2000 <= len(triangles) <= 4000
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.5).max() < 0.005
    assert volume(vertices, triangles) == pytest.approx(0.5**3 * 4.0 / 3.0 * np.pi, rel=0.01)


def test_a_mirrored_mesh_is_not_inside_out(tmp_path: Path) -> None:
    stl(tmp_path / "ball.stl", np.array([2.0, 0.0, 0.0]) + sphere(10))
    shown = mesh_scene(tmp_path, '<mesh filename="ball.stl" scale="-1 1 1"/>')
    vertices, triangles = decoded(shown["visuals"][0])
    assert vertices[:, 0].max() < 0.0
    assert volume(vertices, triangles) > 3.9


def test_separate_triangles_do_not_vanish(tmp_path: Path) -> None:
    stl(tmp_path / "soup.stl", np.random.default_rng(1).normal(size=(6000, 3, 3)))
    _, triangles = decoded(mesh_scene(tmp_path, '<mesh filename="soup.stl"/>')["visuals"][0])
    assert 1000 < len(triangles) <= 4000


def test_all_meshes_of_a_robot_share_one_limit(tmp_path: Path) -> None:
    stl(tmp_path / "ball.stl", sphere(40))
    shown = mesh_scene(tmp_path, '<mesh filename="ball.stl"/></geometry></visual>' + 29 * visual(
        '<mesh filename="ball.stl"/>') + "<visual><geometry>" + '<mesh filename="ball.stl"/>')  # fmt: skip
    counts = [len(decoded(each)[1]) for each in shown["visuals"] if each["shape"] == "mesh"]
    assert len(counts) == 31
    assert sum(counts) <= 60_000


def test_the_colors_of_a_collada_file_are_kept() -> None:
    path, options = source("ur5")
    shown = robot_scene(path, **options)
    wrist = [visual for visual in shown["visuals"] if visual["name"] == "wrist_3_link"]
    colors = [np.round(visual["color"], 3).tolist() for visual in wrist]
    assert colors == [[0.1, 0.103, 0.109, 1.0], [0.215, 0.215, 0.215, 1.0]]
    assert sum(len(decoded(visual)[1]) for visual in wrist) == 1658
    assert sum(len(decoded(visual)[1]) for visual in shown["visuals"] if visual["shape"] == "mesh") < 28_000  # fmt: skip
    assert len(json.dumps(shown)) < 1_000_000


def test_a_huge_mesh_is_a_note(tmp_path: Path) -> None:
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate(84 + 50 * 10_000_000)  # a sparse file
    shown = mesh_scene(tmp_path, '<mesh filename="huge.stl"/>')
    assert len(shown["visuals"]) == 1
    (note,) = shown["notes"]
    assert "476.8 MiB, but at most 64 MiB are expected: reduce the number" in note


def lying(path: Path) -> None:
    stl(path, sphere(4))
    data = bytearray(path.read_bytes())
    data[80:84] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)


DAMAGED: dict[str, Callable[[Path], object]] = {
    "empty.stl": lambda path: path.write_bytes(b""),
    "noise.stl": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    "noise.dae": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    "empty.dae": lambda path: path.write_text("<COLLADA/>"),
    "index.obj": lambda path: path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\n"),
    "line.obj": lambda path: path.write_text("v 0 0 0\nv 1 0 0\nl 1 2\n"),
    "nan.stl": lambda path: stl(path, np.full((5, 3, 3), np.nan)),
    "far.stl": lambda path: stl(path, sphere(4) * 1e12),
    "count.stl": lying,
    "text.xyz": lambda path: path.write_text("hello"),
}


def test_each_damaged_mesh_is_a_note_and_the_others_are_drawn(tmp_path: Path) -> None:
    for name, write in DAMAGED.items():
        write(tmp_path / name)
    stl(tmp_path / "ball.stl", sphere(4))
    paths = [*(tmp_path / name for name in DAMAGED), tmp_path / "ball.stl"]
    read = mesh.read_meshes(paths)
    *damaged, good = (attempt(path, read[path]) for path in paths)
    assert isinstance(good, list)
    for path, error in zip(paths, damaged, strict=False):
        assert isinstance(error, RobotError), path
        assert str(path) in str(error)


def attempt(path: Path, whole: Any) -> Any:
    try:
        if isinstance(whole, Exception):
            return whole
        return mesh.drawable(path, whole, (1.0, 1.0, 1.0), 100, colored=True)
    except RobotError as error:
        return error


def test_a_file_that_ends_the_reading_process_is_the_only_one_without_a_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = tmp_path / "reader.py"
    text = mesh.READER.read_text().replace("    try:", "    if 'bad' in path:\n        import os\n\n        os.abort()\n    try:", 1)  # fmt: skip
    reader.write_text(text)
    monkeypatch.setattr(mesh, "READER", reader)
    paths = [stl(tmp_path / f"{name}.stl", sphere(4)) for name in ("a", "bad1", "b", "bad2")]
    read = mesh.read_meshes(paths)
    assert [isinstance(part, RobotError) for part in read.values()] == [False, True, False, True]


def test_a_mesh_without_the_extra_is_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "coal", None)
    stl(tmp_path / "ball.stl", sphere(4))
    shown = mesh_scene(tmp_path, '<mesh filename="ball.stl"/>')
    assert len(shown["visuals"]) == 1
    assert "needs the extra export: pip install" in shown["notes"][0]
