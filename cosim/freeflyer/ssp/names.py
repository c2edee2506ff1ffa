"""Namespaces, annotation types and fixed names of SSP files, for the writer and the reader."""

from __future__ import annotations

from xml.etree import ElementTree

from freeflyer.scenario.keys import SCENARIO

DESCRIPTION = "SystemStructure.ssd"
ANNOTATION = "org.freeflyer-cosim"
"""Value of the attribute `type` of our annotations.

Our annotations contain the parts of a scenario for which SSP has no elements.
"""
STEP_ANNOTATION = "com.opensimulationplatform"
"""Value of the attribute `type` of the annotations that contain communication steps.

SSP has no elements for communication steps. libcosim and ecos read these annotations. These two
master programs are not part of this project.
"""
FMU_TYPE = "application/x-fmu-sharedlibrary"
SYSTEM = ("stop_s", "robot", "components", "devices", "facility", "connections", "delayed")
SETTINGS = SCENARIO.keys() - set(SYSTEM)
"""Scenario keys that describe the experiment and not the simulated system.

One of our annotations contains a TOML text with these keys and their values.
"""

# libcosim and ecos compare the prefixes of XML names, and not the namespaces. Therefore the
# prefixes in this table must not change.
NAMESPACES = {
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "freeflyer": "urn:freeflyer-cosim:ssp",
}
for _prefix, _namespace in NAMESPACES.items():
    ElementTree.register_namespace(_prefix, _namespace)


def tag(name: str) -> str:
    """Convert a name such as `ssd:System` to the form of ElementTree, `{NAMESPACE}System`."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
