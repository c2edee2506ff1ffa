"""Namespaces, annotation types and fixed names of SSP files, for the writer and the reader."""

from __future__ import annotations

from xml.etree import ElementTree

DESCRIPTION = "SystemStructure.ssd"
ANNOTATION = "org.freeflyer-cosim"
"""Type of our annotations, which contain the parts of a scenario that SSP has no elements for."""
STEP_ANNOTATION = "com.opensimulationplatform"
"""Type of the annotations with communication steps, which SSP has no elements for.

libcosim and ecos read them from there.
"""
FMU_TYPE = "application/x-fmu-sharedlibrary"
SETTINGS = (
    "title",
    "paper",
    "expect",
    "exchange",
    "record",
    "limits",
    "errors",
    "observed_energy",
    "roles",
)
"""Scenario keys that describe the experiment, not the system; an annotation has them as TOML."""

# libcosim and ecos compare prefixes instead of namespaces, so these prefixes must not change.
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
    """Convert `ssd:System` to the form of ElementTree, `{NAMESPACE}System`."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
