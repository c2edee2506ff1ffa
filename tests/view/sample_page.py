"""A page of the viewer from made-up data: for the tests of the page, and for its development.

`python tests/view/sample_page.py OUT.html [--two]` writes a page that can be looked at.
"""

from __future__ import annotations

import argparse
import base64
import copy
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).parents[2] / "cosim" / "freeflyer" / "viewer" / "page"
ARM = (  # kind, position, axis as orientation [x, y, z, w] of the joint frame, limits
    ("revolute", [0.0, 0.0, 0.10], [0.0, 0.0, 0.0, 1.0], 2.97),
    ("revolute", [0.0, 0.0, 0.21], [0.5**0.5, 0.0, 0.0, 0.5**0.5], 2.09),
    ("revolute", [0.0, 0.40, 0.0], [0.0, 0.0, 0.0, 1.0], 2.09),
    ("revolute", [0.0, 0.19, 0.0], [-(0.5**0.5), 0.0, 0.0, 0.5**0.5], 2.97),
    ("revolute", [0.0, 0.0, 0.20], [0.5**0.5, 0.0, 0.0, 0.5**0.5], 2.09),
    ("revolute", [0.0, 0.08, 0.0], [-(0.5**0.5), 0.0, 0.0, 0.5**0.5], 2.97),
)


def series(values: Any, scale: float | None = None) -> dict[str, Any]:
    """Return the SERIES of `values` (n): integer deltas, zigzag varints, raw DEFLATE."""
    values = np.asarray(values, float)
    missing = ~np.isfinite(values)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    result: dict[str, Any] = {"n": len(values), "scale": 0.0, "offset": 0.0, "data": ""}
    if missing.any():
        result["nan"] = edges.reshape(-1, 2).tolist()
    known = values[~missing]
    if not len(known):
        return result
    result["offset"] = float(known[0])
    if np.ptp(known) == 0:
        return result
    result["scale"] = scale = scale or float(np.ptp(known)) * 2.0**-40
    filled = np.where(missing, known[0], values)
    integers = np.rint((filled - known[0]) / scale).astype(np.int64)
    deltas = np.diff(integers, prepend=np.int64(0))
    zigzag = ((deltas << 1) ^ (deltas >> 63)).astype(np.uint64)
    shifts = np.arange(0, 70, 7, dtype=np.uint64)
    groups = (zigzag[:, None] >> np.minimum(shifts, np.uint64(63))) & np.uint64(0x7F)
    groups[:, 9] = zigzag >> np.uint64(63)
    used = np.maximum(1, 10 - (groups[:, ::-1] != 0).argmax(axis=1))
    used[zigzag == 0] = 1
    position = np.arange(10)
    coded = np.where(position < (used - 1)[:, None], groups | np.uint64(0x80), groups)
    raw = coded[position < used[:, None]].astype(np.uint8).tobytes()
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    result["data"] = base64.b64encode(packer.compress(raw) + packer.flush()).decode()
    return result


def triple(values: Any) -> list[dict[str, Any]]:
    """Return one SERIES for each column of `values` (n, m)."""
    return [series(column) for column in np.asarray(values, float).T]


def rotation(quaternion: Any) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion [x, y, z, w]."""
    x, y, z, w = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def transform(position: Any, orientation: Any) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) of a pose."""
    result = np.eye(4)
    result[:3, :3] = rotation(orientation)
    result[:3, 3] = position
    return result


def forward_kinematics(scene: dict[str, Any], base: np.ndarray, joints: Any) -> list[np.ndarray]:
    """Return T_0, ..., T_n, T_E in I (each 4 x 4) of `scene` for one base pose and n joints."""
    frames = [base]
    frame = base
    for joint, value in zip(scene["joints"], joints, strict=True):
        moved = np.eye(4)
        if joint["kind"] == "prismatic":
            moved[2, 3] = value
        else:
            c, s = np.cos(value), np.sin(value)
            moved[:2, :2] = [[c, -s], [s, c]]
        frame = frame @ transform(joint["position"], joint["orientation"]) @ moved
        frames.append(frame)
    end = scene["end_effector"]
    return [*frames, frame @ transform(end["position"], end["orientation"])]


def scene() -> dict[str, Any]:
    """Return a servicer: a bus with two solar panels, an arm of six joints, a tool."""
    joints = [
        {
            "name": f"joint_{k + 1}",
            "kind": kind,
            "position": [0.0, 0.0, position[2] + 0.35] if k == 0 else position,
            "orientation": orientation,
            "lower": -limit,
            "upper": limit,
        }
        for k, (kind, position, orientation, limit) in enumerate(ARM)
    ]
    none, along_y = [0.0, 0.0, 0.0, 1.0], [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
    white, orange, dark = [0.93, 0.93, 0.9, 1.0], [0.85, 0.47, 0.15, 1.0], [0.25, 0.27, 0.3, 1.0]
    visuals: list[dict[str, Any]] = []

    def add(
        frame: int, name: str, at: list[float], turned: list[float], color: list[float], **of: Any
    ) -> None:
        visuals.append(
            {
                "frame": frame,
                "name": name,
                "position": at,
                "orientation": turned,
                "color": color,
                **of,
            }
        )

    add(0, "bus", [0, 0, 0], none, [0.78, 0.72, 0.55, 1.0], shape="box", size=[0.6, 0.7, 0.7])
    for side in (-1, 1):
        at = [0, side * 1.05, 0.05]
        add(0, "panel", at, none, [0.1, 0.17, 0.4, 1.0], shape="box", size=[0.55, 1.2, 0.02])
        add(
            0,
            "boom",
            [0, side * 0.4, 0.05],
            along_y,
            dark,
            shape="cylinder",
            radius=0.02,
            length=0.12,
        )
    add(0, "mount", [0, 0, 0.4], none, dark, shape="cylinder", radius=0.09, length=0.1)
    add(1, "link", [0, 0, 0.1], none, white, shape="capsule", radius=0.06, length=0.12)
    add(2, "joint", [0, 0, 0], none, orange, shape="cylinder", radius=0.065, length=0.15)
    add(2, "link", [0, 0.2, 0], along_y, white, shape="capsule", radius=0.055, length=0.3)
    add(3, "joint", [0, 0, 0], none, orange, shape="cylinder", radius=0.06, length=0.14)
    add(3, "link", [0, 0.1, 0], along_y, white, shape="capsule", radius=0.05, length=0.1)
    add(4, "link", [0, 0, 0.1], none, white, shape="capsule", radius=0.045, length=0.12)
    add(5, "joint", [0, 0, 0], none, orange, shape="sphere", radius=0.06)
    add(6, "flange", [0, 0, 0.03], none, dark, shape="cylinder", radius=0.045, length=0.05)
    corner = np.array(
        [
            [0.03, 0.03, 0.05],
            [-0.03, 0.03, 0.05],
            [-0.03, -0.03, 0.05],
            [0.03, -0.03, 0.05],
            [0, 0, 0.12],
        ],
        "<f4",
    )
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [2, 1, 0], [3, 2, 0]], "<u4")
    add(
        6, "tool", [0, 0, 0], none, dark, shape="mesh",
        vertices=base64.b64encode(corner.tobytes()).decode(),
        triangles=base64.b64encode(faces.tobytes()).decode(),
    )  # fmt: skip
    inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
    bodies = [
        {"frame": k, "name": f"link_{k}", "mass": 150.0 if k == 0 else 2.5,
         "centre_of_mass": [0.0, 0.0, 0.0], "inertia": inertia}
        for k in range(7)
    ]  # fmt: skip
    return {
        "format": 1,
        "name": "sample_servicer",
        "joints": joints,
        "locked": [],
        "end_effector": {"position": [0.0, 0.0, 0.12], "orientation": none},
        "mount": {"position": [0.0, 0.0, 0.35], "orientation": none},
        "bodies": bodies,
        "visuals": visuals,
        "drawn": "urdf",
    }


def quaternions(vectors: np.ndarray) -> np.ndarray:
    """Return the quaternions (n, 4) of rotation vectors (n, 3)."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([vectors / 2 * np.sinc(angle / (2 * np.pi)), np.cos(angle / 2)])


def quaternion_of(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion [x, y, z, w] of a rotation matrix (3, 3)."""
    q = np.empty(4)
    i = int(np.argmax(np.diag(matrix)))
    j, k = (i + 1) % 3, (i + 2) % 3
    if np.trace(matrix) > 0:
        q[3] = np.sqrt(1 + np.trace(matrix)) / 2
        for a, b, c in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):
            q[a] = (matrix[b, c] - matrix[c, b]) / (4 * q[3])
        return q
    q[i] = np.sqrt(max(0.0, 1 + matrix[i, i] - matrix[j, j] - matrix[k, k])) / 2
    q[3] = (matrix[k, j] - matrix[j, k]) / (4 * q[i])
    q[j] = (matrix[j, i] + matrix[i, j]) / (4 * q[i])
    q[k] = (matrix[k, i] + matrix[i, k]) / (4 * q[i])
    return q


def motion(
    duration: float = 20.0, rate: float = 100.0, growth: float = -0.02
) -> dict[str, np.ndarray]:
    """Return time (n), position (n, 3), orientation (n, 4), joints (n, 6) and end (n, 4, 4).

    Position and orientation are those of the base, end is frame E. The base oscillates with an
    amplitude that grows with exp(growth t).
    """
    t = np.arange(round(duration * rate) + 1) / rate
    swing = (1e-3 * np.exp(growth * t))[:, None] * np.sin(2 * np.pi * np.outer(t, [0.5, 0.4, 0.3]))
    posture = np.array([0.2, 0.7, -1.4, 0.1, -0.9, 0.3])
    joints = posture + 0.25 * np.sin(2 * np.pi * np.outer(t / duration, [1, 2, 1, 1, 2, 3]))
    orientation = quaternions(2 * swing[:, [1, 2, 0]])
    model = scene()
    end = np.array(
        [
            forward_kinematics(model, transform(p, o), q)[-1]
            for p, o, q in zip(swing, orientation, joints, strict=True)
        ]
    )
    return {"time": t, "position": swing, "orientation": orientation, "joints": joints, "end": end}


def run(
    label: str = "with PC", growth: float = -0.02, duration: float = 20.0, rate: float = 100.0
) -> dict[str, Any]:
    """Return a RUN of the sample robot with a small deviation from its reference."""
    m = motion(duration, rate, growth)
    t, end = m["time"], m["end"]
    grow = np.exp(growth * t)[:, None]
    wave = 2e-3 * grow * np.sin(2 * np.pi * np.outer(t, [0.45, 0.6, 0.3]) + [0, 1, 2])
    wanted = end[:, :3, 3] + wave
    wanted_orientation = np.array([quaternion_of(T[:3, :3]) for T in end])
    force_b = 5 * grow * np.cos(2 * np.pi * np.outer(t, [0.5, 0.4, 0.3])) + [2, 0, 1]
    force_m = 0.4 * grow * np.sin(2 * np.pi * np.outer(t, [1.1, 0.7, 0.9])) + [0.2, 0.1, 0]
    active = ((t % 6) > 4).astype(float)[:, None]
    energy = 0.05 - 0.004 * np.cumsum(np.exp(growth * t)) / rate * (1 + 0.3 * np.sin(3 * t))
    error = np.linalg.norm(wave, axis=1)
    clock = series(t, 1e-9)

    def plot(title: str, unit: str, **signals: Any) -> dict[str, Any]:
        return {
            "title": title,
            "unit": unit,
            "signals": [
                {"label": name.replace("_", " "), "time": clock, "value": series(value)}
                for name, value in signals.items()
            ],
        }

    marks = [
        {"kind": "base sample", "time": float(k), "until": None, "text": f"base sample {k}"}
        for k in range(int(duration) + 1)
    ]
    marks += [
        {
            "kind": "passivity control",
            "time": 4.0 + k,
            "until": 6.0 + k,
            "text": "port B: passivity control acts",
        }
        for k in np.arange(0.0, duration - 5, 6).tolist()
    ]
    marks.append(
        {"kind": "fault", "time": 7.3, "until": None, "text": "frame lost on the link of the base"}
    )
    return {
        "label": label,
        "title": f"sample, {label}",
        "end": {"kind": "completed", "time": float(t[-1]), "cause": None},
        "scene": scene(),
        "notes": [],
        "time": clock,
        "base": {"position": triple(m["position"]), "orientation": triple(m["orientation"])},
        "joints": triple(m["joints"]),
        "desired": {"position": triple(wanted), "orientation": triple(wanted_orientation)},
        "set_point": {"position": [0.0, 0.0, 0.0], "orientation": [0.0, 0.0, 0.0, 1.0]},
        "wrenches": [
            {"name": "port B", "at": "base", "passivity": False,
             "force": triple(force_b), "torque": triple(0.3 * force_b[:, [1, 2, 0]])},
            {"name": "port M", "at": "end_effector", "passivity": False,
             "force": triple(force_m), "torque": triple(0.1 * force_m[:, [1, 2, 0]])},
            {"name": "passivity controller of port B", "at": "base", "passivity": True,
             "force": triple(-0.6 * active * force_b), "torque": triple(-0.1 * active * force_b)},
        ],
        "plots": [
            plot("position error", "m", end_effector=error, base=np.linalg.norm(m["position"], axis=1)),
            plot("observed energy", "J", port_B=energy, port_M=0.05 + 0.01 * np.sin(t / 3)),
            plot("kinetic energy", "J", kinetic_energy=1e-3 * (1 + np.sin(t) ** 2)),
            plot("force at port B", "N", x=force_b[:, 0], y=force_b[:, 1], z=force_b[:, 2]),
            plot("passivity controller of port B", "N", force=0.6 * active[:, 0] * np.linalg.norm(force_b, axis=1)),
        ],
        "marks": marks,
        "center_of_mass": triple(m["position"] + [0.0, 0.0, 0.08]),
        "momentum": {"linear": triple(166 * np.gradient(m["position"], t, axis=0)),
                     "angular": triple(0.2 * np.sin(np.outer(t, [0.3, 0.2, 0.1])))},
        "joint_margin": series(2.09 - np.abs(m["joints"]).max(axis=1)),
    }  # fmt: skip


def document(
    *runs: dict[str, Any], title: str = "sample", notes: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return the data of a page with `runs`."""
    return {
        "format": 1, "title": title, "runs": list(runs), "created_by": "sample_page", "notes": list(notes)
    }  # fmt: skip


def cut(run: dict[str, Any], time: float, cause: str) -> dict[str, Any]:
    """Return `run` with the end "diverged" at `time`; its series stay as they are."""
    result = copy.copy(run)
    result["end"] = {"kind": "diverged", "time": time, "cause": cause}
    stop = {"kind": "stop", "time": time, "until": None, "text": cause}
    result["marks"] = [*run["marks"], stop]
    return result


def write(path: Path, data: dict[str, Any]) -> Path:
    """Write the page with `data` and the built bundle to `path`."""
    script = (PAGE / "viewer.js").read_text(encoding="utf-8")
    style = (PAGE / "viewer.css").read_text(encoding="utf-8")

    def source(text: str) -> str:
        return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"

    policy = (
        f"default-src 'none'; script-src {source(script)}; style-src {source(style)}; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    text = json.dumps(data).replace("<", "\\u003c")
    path.write_text(
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>sample</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f'<script type="application/json" id="data">{text}</script>\n<script>{script}</script>\n</body>\n</html>\n',
        encoding="utf-8",
    )
    return path


def main() -> None:
    """Write a sample page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--two", action="store_true", help="compare two runs")
    options = parser.parse_args()
    runs = [run()]
    if options.two:
        cause = "manipulator_controller: smallest singular value of J_m is 0.0194"
        runs.append(cut(run("without PC", 0.15, duration=14.0), 14.0, cause))
    print(write(options.out, document(*runs)))


if __name__ == "__main__":
    main()
