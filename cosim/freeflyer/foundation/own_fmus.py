"""Names in the FMUs of this project. The writer and the reader of the FMUs use these names."""

from __future__ import annotations

OWN_TOOL = "freeflyer-cosim"
"""Value of the attribute generationTool in our FMUs.

Our FMUs keep no state outside their instances. Therefore some precautions apply only to other FMUs.
"""
UNITS_ANNOTATION = "org.freeflyer-cosim.units"
"""Type of the FMI 3.0 annotation that contains the units of an array, one unit per element."""
REQUIREMENT = "logRequirement"
"""Log category. Our FMUs use it only if the equations have left their range of validity.

See `StepFailed.left_validity`.
"""
