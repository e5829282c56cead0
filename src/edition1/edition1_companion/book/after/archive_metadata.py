"""Write what archives read, `.zenodo.json` and `codemeta.json`, from `CITATION.cff`: change that, then run this."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import yaml
from edition1.files import write_whole

from edition1_companion.book.project import Project, find_project


def metadata(project: Project) -> dict[str, dict[str, Any]]:
    """Return the content of both files by their names."""
    citation = yaml.safe_load((project.root / "CITATION.cff").read_text(encoding="utf-8"))
    package = tomllib.loads((project.root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    dois = [reference["doi"] for reference in citation["references"] if "doi" in reference]
    authors = [author["name"] for author in citation["authors"]]
    zenodo = {
        "title": citation["title"],
        "description": package["description"],
        "version": citation["version"],
        "upload_type": citation["type"],
        "access_right": "open",
        "license": citation["license"].lower(),
        "creators": [{"name": name} for name in authors],
        "keywords": citation["keywords"],
        "related_identifiers": [
            {"identifier": doi, "relation": "isSupplementTo", "scheme": "doi"} for doi in dois
        ],
    }
    codemeta = {
        "@context": "https://w3id.org/codemeta/3.0",
        "@type": "SoftwareSourceCode",
        "name": citation["title"],
        "description": package["description"],
        "version": citation["version"],
        "license": f"https://spdx.org/licenses/{citation['license']}",
        "author": [{"@type": "Organization", "name": name} for name in authors],
        "keywords": citation["keywords"],
        "programmingLanguage": "Python",
        "codeRepository": package["urls"]["Repository"],
        "referencePublication": [
            {"@type": "ScholarlyArticle", "name": reference["title"]} for reference in citation["references"]
        ],
    }
    return {".zenodo.json": zenodo, "codemeta.json": codemeta}


def text(content: dict[str, Any]) -> str:
    """Return the text of a file."""
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    here = find_project()
    for name, content in metadata(here).items():
        write_whole(here.root / name, text(content))
