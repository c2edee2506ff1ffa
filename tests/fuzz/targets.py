"""All fuzzing targets, by name.

To fuzz another reader, add a `Target` to this list and a number of inputs in test_campaigns:

Target(name="recover", generate=lambda rng: mutation.damaged(rng, [VALID]), call=recover_bytes,
       allowed=(RecordError,))
"""

from __future__ import annotations

from collections.abc import Mapping

import file_targets
import link_targets
import record_target
import recover_target
import scenario_target
from target import Target

TARGETS: Mapping[str, Target] = {
    target.name: target
    for target in (
        link_targets.CAN,
        link_targets.CDR,
        link_targets.ATTACHMENT_TARGET,
        scenario_target.SCENARIO,
        file_targets.FMU_TARGET,
        file_targets.SSP_TARGET,
        file_targets.DBC_TARGET,
        record_target.RECORD,
        recover_target.RECOVER,
    )
}
