"""Build hook: the wheel carries a CycloneDX list of its declared dependencies, as PEP 770 asks.

The wheel holds no code of others. The list names each dependency with its range of versions, not the version
that a machine installs. Dependencies of dependencies are not listed; the list says so.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version


class CustomBuildHook(BuildHookInterface):  # hatchling looks for this name
    """Writes the list to a temporary folder, from which hatchling packs it into `.dist-info/sboms/`."""

    def initialize(self, _version: str, build_data: dict[str, Any]) -> None:
        """Add the list to the files of the wheel."""
        core = self.metadata.core
        needed = {"": core.dependencies, **core.optional_dependencies}
        content = bill_of_materials(core.name, self.metadata.version, core.license_expression, needed)
        self._folder = tempfile.TemporaryDirectory()
        path = Path(self._folder.name) / f"{core.name}.cdx.json"
        path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        build_data.setdefault("sbom_files", []).append(str(path))

    def finalize(self, _version: str, _build_data: dict[str, Any], _artifact_path: str) -> None:
        """Remove the temporary folder."""
        self._folder.cleanup()


def bill_of_materials(name: str, version: str, licence: str, needed: dict[str, list[str]]) -> dict[str, Any]:
    """CycloneDX document; `needed` holds the requirements of each extra, those of no extra under ""."""
    itself = f"pkg:pypi/{name}@{version}"
    components = []
    for extra, requirements in needed.items():
        for requirement in map(Requirement, requirements):
            other = canonicalize_name(requirement.name)
            if other == name:
                continue  # an extra that consists of other extras
            component = {
                "type": "library",
                "bom-ref": f"{extra}/{other}" if extra else other,
                "name": other,
                "versionRange": version_range(requirement.specifier),
                "isExternal": True,
                "purl": f"pkg:pypi/{other}",
                "scope": "optional" if extra else "required",
            }
            if extra:
                component["properties"] = [{"name": "python:extra", "value": extra}]
            components.append(component)
    references = [component["bom-ref"] for component in components]
    about = {"type": "application", "bom-ref": itself, "name": name, "version": version, "purl": itself}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.7",
        "version": 1,
        "metadata": {
            "lifecycles": [{"phase": "build"}],
            "component": about | {"licenses": [{"expression": licence}]},
        },
        "components": components,
        "dependencies": [{"ref": itself, "dependsOn": references}],
        "compositions": [
            {"aggregate": "complete", "assemblies": [itself], "dependencies": [itself]},
            {"aggregate": "unknown", "dependencies": references},
        ],
    }


def version_range(specifiers: SpecifierSet) -> str:
    """Range in the `vers` notation, such as vers:pypi/>=3.16|<4."""
    bounds = sorted(specifiers, key=lambda bound: Version(bound.version))
    return "vers:pypi/" + ("|".join(f"{bound.operator}{bound.version}" for bound in bounds) or "*")
