"""The environment: what uv gets of that which pip is told, and its own lock."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PLACE = importlib.util.spec_from_file_location("environment", ROOT / "scripts" / "environment.py")
environment = importlib.util.module_from_spec(PLACE)
PLACE.loader.exec_module(environment)


def test_options_of_pip_are_those_of_its_files_and_of_the_environment():
    said = ":env:.index-url='https://b/simple'\nglobal.cert='/c.pem'\nglobal.index-url='https://a/simple'\nuser = x\n"
    assert environment.told_to_pip(said) == {"index-url": "https://b/simple", "cert": "/c.pem"}


@pytest.mark.parametrize(
    ("option", "value", "arguments", "own"),
    [
        ("index-url", "https://a/simple", ["--default-index", "https://a/simple"], {}),
        ("extra-index-url", "https://a https://b", ["--index", "https://a", "--index", "https://b"], {}),
        ("find-links", "/wheels", ["--find-links", "/wheels"], {}),
        ("no-index", "true", ["--no-index"], {}),
        ("cert", "/c.pem", [], {"SSL_CERT_FILE": "/c.pem"}),
        ("proxy", "http://p:3128", [], {"ALL_PROXY": "http://p:3128"}),
        ("constraint", "/pins.txt", ["--verify-hashes"], {"UV_CONSTRAINT": "/pins.txt"}),
    ],
)
def test_uv_gets_what_pip_is_told(option, value, arguments, own):
    plain, _ = environment.as_uv_takes_it({}, {})
    found, variables = environment.as_uv_takes_it(
        {option: value}, {"HOME": "/home/a", "UV_CACHE_DIR": "/cache"}
    )
    assert [word for word in found if word not in plain] == arguments
    assert variables == {"HOME": "/home/a", "UV_CACHE_DIR": "/cache", **own}
    assert ("--require-hashes" in found) == (option != "constraint")


def test_uv_is_locked_with_hashes():
    wanted = environment.uv_requirement((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    first, *hashes = wanted.splitlines()
    assert first.startswith("uv==")
    assert len(hashes) > 10
    assert all(line.strip().startswith("--hash=sha256:") for line in hashes)
