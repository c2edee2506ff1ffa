"""What has to be known of a record to read its energy audit, one sentence each."""

from __future__ import annotations

import numpy as np

from freeflyer.analysis.audit.recorded_loop import RecordedLoop
from freeflyer.foundation.clock import seconds


def notes(loop: RecordedLoop) -> list[str]:
    said = []
    step = loop.interval
    laws = {"manipulator": loop.manipulator_law, "base": loop.base_law}
    if loop.plant is None:
        said.append(
            "No component has the robot's kinetic_energy under base_wrench and joint_torque (at the facility the arm moves in 1 g "
            "behind its drives), so there is no balance to close: work is that of the commanded wrenches on the measured motion."
        )
    if any(law.period < step for law in laws.values()):
        finest = seconds(min(law.period for law in laws.values()))
        said.append(
            f"The record has a row every {seconds(step):g} s, but not every sample is a row, so that work is approximated: "
            f"`freeflyer run SCENARIO --set record.every_s={finest:g}` {'closes the balance' if loop.plant else 'has them all'}."
        )
    for name, law in laws.items():
        if law.period > step and law.period % step:
            said.append(
                f"The {name}'s samples, every {seconds(law.period):g} s, fall between the record's rows, every {seconds(step):g} s: "
                "its work is approximated."
            )
        if not law.is_plain:
            said.append(
                f"The {name}'s sampled gains are not recorded: its virtual energy is that of the whole law, feed-forward included, "
                "beyond the continuous K_P and K_D."
            )
        turning = law.stiffness[3:]
        if np.ptp(turning) > 0.0:
            said.append(
                f"The {name}'s rotational stiffness is not isotropic, so that its torque has no potential: its virtual energy holds "
                "that, too."
            )
    if loop.joint_torque.shape[1] != 6:
        said.append(
            "The arm has joint torques in the null space of J_m, whose work is in the residual of the ports."
        )
    if loop.rows_left_out:
        said.append(f"The last {loop.rows_left_out} rows are left out: they are not finite.")
    return said
