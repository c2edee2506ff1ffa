"""What the writer and the reader of SSP files share: namespaces, annotation types, the file's fixed names."""

from __future__ import annotations

from xml.etree import ElementTree

DESCRIPTION = "SystemStructure.ssd"
ANNOTATION = "org.freeflyer-cosim"
"""Type of our annotations: what of a scenario SSP has no place for."""
STEP_ANNOTATION = "com.opensimulationplatform"
"""Type of the annotations in which libcosim and ecos look for communication steps; neither SSP 1.0 nor 2.0 has a place for them."""
FMU_TYPE = "application/x-fmu-sharedlibrary"
SETTINGS = ("title", "paper", "expect", "exchange", "record", "limits", "errors", "observed_energy")
"""Keys of a scenario that are about the experiment and not about the system; they travel as TOML."""

# libcosim and ecos compare prefixes, not namespaces: these prefixes are part of the format for them.
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
    """`ssd:System` -> the name as ElementTree writes it."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
