"""What others read of the project: workflows, forms, and what its owner has still to fill in."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def test_addresses_are_whole_and_the_owner_is_named():
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]
    assert all(re.fullmatch(r"https://[\w./-]+", url) for url in urls.values())
    if any("OWNER" in url for url in urls.values()):
        pytest.skip("for the owner to fill in before a release: OWNER in pyproject.toml")


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_has_what_it_needs_and_calls_the_front_door(path):
    workflow = yaml.safe_load(path.read_text())
    assert workflow[True], "when it runs; YAML reads the word on as true"
    assert workflow["permissions"]["contents"] == "read"
    commands = [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]
    makes = {word for command in commands for word in re.findall(r"make ([a-z-]+)", command)}
    assert makes or "bash .ci/run" in commands
    assert makes <= set(re.findall(r"^([a-z-]+):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for job in workflow["jobs"].values():
        assert "needs" not in job or job["needs"] in workflow["jobs"]
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            assert re.fullmatch(r"actions/[a-z-]+@v\d+", step.get("uses", "actions/a@v1"))
