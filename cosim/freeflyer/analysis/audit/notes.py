"""Notes on the limitations of an energy audit. They depend on the record that is audited."""

from __future__ import annotations

import numpy as np

from freeflyer.analysis import observer_notes
from freeflyer.analysis.audit.recorded_loop import RecordedLoop
from freeflyer.foundation.clock import seconds


def notes(loop: RecordedLoop) -> list[str]:
    """Return the notes on a recorded loop. The list is empty if the audit has no limitation."""
    found = []
    step = loop.interval
    laws = {"manipulator": loop.manipulator_law, "base": loop.base_law}
    # Limitations that come from the record.
    if loop.plant is None:
        found.append(
            "No component has the output kinetic_energy and receives base_wrench and joint_torque. (The facility has no such "
            "component, because drives move its arm under gravity.) Therefore the audit has no energy balance. The work is computed "
            "from the commanded wrenches and the measured motion."
        )
    if any(law.period < step for law in laws.values()):
        finest = seconds(min(law.period for law in laws.values()))
        found.append(
            f"The record has one row every {seconds(step):g} s and does not have all samples. Therefore the work is approximated. "
            f"The command `freeflyer run SCENARIO --set record.every_s={finest:g}` records all samples{' and closes the balance' if loop.plant else ''}."
        )
    # Limitations of one controller.
    for name, law in laws.items():
        if law.period > step and law.period % step:
            found.append(
                f"The period of the {name} controller, {seconds(law.period):g} s, is not a multiple of the row interval, "
                f"{seconds(step):g} s. Therefore the work of this controller is approximated."
            )
        if not law.is_plain:
            found.append(
                f"The discrete gains of the {name} controller are not recorded. Therefore its virtual energy is the work of the whole "
                "law, with feed-forward, minus the work of a continuous spring-damper with K_P and K_D."
            )
        if np.ptp(law.stiffness[3:]) > 0.0:
            found.append(
                f"The rotational stiffness of the {name} controller is not isotropic. Therefore the torque of its spring has no "
                "potential energy. The virtual energy of its law includes this effect."
            )
    found += observer_notes.notes(loop.provenance)
    # Work that is not in the balance.
    if loop.joint_torque.shape[1] != 6:
        found.append(
            "The arm has joint torques in the null space of J_m. Their work is part of the residual of the balance with port work."
        )
    if loop.rows_left_out:
        found.append(
            f"The last {loop.rows_left_out} rows are left out, because they contain values that are not finite."
        )
    return found
