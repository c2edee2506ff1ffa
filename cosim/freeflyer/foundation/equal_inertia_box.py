"""Box with the mass and inertia of a body, for a viewer that has no other shape of this body."""

from __future__ import annotations

from collections.abc import Sequence


def equal_inertia_box(
    mass: float, inertia: Sequence[float]
) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Return the edges [m] of the box and its orientation, a quaternion (x, y, z, w).

    `inertia` contains xx, yy, zz, xy, xz, yz [kg m2] about the centre of mass. The homogeneous box
    with this mass and inertia is oriented along the principal axes. An edge is at least 2 % of the
    longest edge, because the inertia of a flat body gives an edge of length zero.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    xx, yy, zz, xy, xz, yz = inertia
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # Order the principal axes so that the box is turned as little as possible.
    order = [int(np.argmax(np.abs(axes[0])))]
    order.append(max((k for k in range(3) if k != order[0]), key=lambda k: float(abs(axes[1, k]))))
    order.append(3 - sum(order))
    axes, moments = axes[:, order], moments[order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] *= -1.0
    edges = np.sqrt(np.maximum(6.0 / mass * (moments.sum() - 2.0 * moments), 0.0))
    x, y, z = np.maximum(edges, 0.02 * edges.max())
    qx, qy, qz, qw = Rotation.from_matrix(axes).as_quat()
    return (float(x), float(y), float(z)), (float(qx), float(qy), float(qz), float(qw))
