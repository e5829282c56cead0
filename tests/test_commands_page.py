"""The page on the commands: it has every command once, and each command and option that it names exists."""

import re
import shlex
from pathlib import Path

import pytest

from repro_companion import cli

PAGE = (Path(__file__).parents[1] / "book" / "commands.md").read_text(encoding="utf-8")
COMMANDS = [name for name in cli.app if not name.startswith("-")]
SECTIONS = dict(re.findall(r"^### `repro (\w+)`\n(.*?)(?=^##|\Z)", PAGE, re.DOTALL | re.MULTILINE))


def options(command: str) -> set[str]:
    """Return the options that a command takes."""
    return {name for argument in cli.app[command].assemble_argument_collection() for name in argument.names}


def test_every_command_has_a_section():
    assert sorted(SECTIONS) == sorted(COMMANDS)


@pytest.mark.parametrize("name", SECTIONS)
def test_options_exist_and_are_all_named(name):
    text = SECTIONS[name]
    said = {word for word in re.findall(r"(?<![\w-])(--?[a-z][a-z-]*)", text) if word != "-p"}
    known = options(name)
    assert said <= known | {"--parameter"}, said - known
    shared = set(re.findall(r"(--[a-z-]+)", PAGE))
    assert {option for option in known if option.startswith("--")} - shared <= {"--output", "--parameter"}


@pytest.mark.parametrize("line", re.findall(r"^repro .*$", PAGE, re.MULTILINE))
def test_examples_can_be_parsed(line):
    command, *words = shlex.split(line)[1:]
    cli.app[command].parse_args(words, exit_on_error=False, print_error=False)
