"""Notes on the limitations of an energy audit, derived from its record."""

from __future__ import annotations

import numpy as np

from freeflyer.analysis.audit.recorded_loop import RecordedLoop
from freeflyer.foundation.clock import seconds


def notes(loop: RecordedLoop) -> list[str]:
    """Return the notes on a recorded loop; an empty list if the audit has no limitation."""
    found = []
    step = loop.interval
    laws = {"manipulator": loop.manipulator_law, "base": loop.base_law}
    if loop.plant is None:
        found.append(
            "No component outputs kinetic_energy and receives base_wrench and joint_torque (at the facility the arm is driven in 1 g), "
            "so the audit has no energy balance. Work is that of the commanded wrenches on the measured motion."
        )
    if any(law.period < step for law in laws.values()):
        finest = seconds(min(law.period for law in laws.values()))
        found.append(
            f"The record has a row every {seconds(step):g} s and does not have all samples, so work is approximated: "
            f"`freeflyer run SCENARIO --set record.every_s={finest:g}` {'closes the balance' if loop.plant else 'records all samples'}."
        )
    for name, law in laws.items():
        if law.period > step and law.period % step:
            found.append(
                f"The {name} controller samples every {seconds(law.period):g} s, which is not a multiple of the row interval of "
                f"{seconds(step):g} s, so its work is approximated."
            )
        if not law.is_plain:
            found.append(
                f"The sampled gains of the {name} controller are not recorded. Its virtual energy is therefore that of the whole law, "
                "including feed-forward, beyond the continuous K_P and K_D."
            )
        if np.ptp(law.stiffness[3:]) > 0.0:
            found.append(
                f"The rotational stiffness of the {name} controller is not isotropic, so its torque has no potential. Its virtual "
                "energy includes this effect."
            )
    if loop.joint_torque.shape[1] != 6:
        found.append(
            "The arm has joint torques in the null space of J_m; their work is part of the residual of the ports."
        )
    if loop.rows_left_out:
        found.append(f"The last {loop.rows_left_out} rows are left out: they are not finite.")
    return found
