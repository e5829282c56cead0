"""Install locked packages into the environment of this interpreter: by uv, or by pip where uv cannot be had.

``python scripts/environment.py PACKAGES`` takes a file of requirements with hashes. uv gets what pip is told:
indexes, folders of packages, certificates, constraints, a proxy. Modules are compiled when they are imported first.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OPTIONS = {"index-url": "--default-index", "extra-index-url": "--index", "find-links": "--find-links"}
"""Options of pip and of uv that may be given more than once."""
LOCKED = ["--no-deps", "--require-hashes", "--quiet"]


def told_to_pip(config: str) -> dict[str, str]:
    """Return pip's options from what ``pip config list`` prints; those of the environment win."""
    lines = (re.fullmatch(r"(global|install|:env:)\.([\w-]+)=(.*)", line) for line in config.splitlines())
    found = [(("global", "install", ":env:").index(m[1]), m[2], ast.literal_eval(m[3])) for m in lines if m]
    return {name: value for _, name, value in sorted(found, key=lambda option: option[0])}


def as_uv_takes_it(options: dict[str, str], environment: dict[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return arguments and environment of uv for pip's options."""
    # uv would want hashes of constraints too; hashes that stand in a file are verified in any case.
    arguments = ["--no-deps", "--quiet", "--verify-hashes" if "constraint" in options else "--require-hashes"]
    arguments += ["--no-index"] * ("no-index" in options)
    for name, own in OPTIONS.items():
        for value in options.get(name, "").split():
            arguments += [own, value]
    # As pip does: of all indexes the best file, not the first index that knows the name.
    arguments += ["--index-strategy", "unsafe-best-match"]
    names = {"cert": "SSL_CERT_FILE", "constraint": "UV_CONSTRAINT", "proxy": "ALL_PROXY"}
    own = {names[name]: value for name, value in options.items() if name in names}
    return arguments, {"UV_CACHE_DIR": str(ROOT / ".cache" / "uv"), **environment, **own}


def uv_requirement(lock: str) -> str:
    """Return the locked requirement of uv, with its hashes."""
    found = re.search(r"^uv==(?:.*\\\n)*.*\n", lock, re.MULTILINE)
    return found[0] if found else ""


def by_uv(packages: Path) -> bool:
    """Install by uv; return whether it did."""
    pip = [sys.executable, "-m", "pip"]
    wanted = packages.with_name("uv.txt")
    wanted.write_text(
        uv_requirement((ROOT / "requirements.lock").read_text(encoding="utf-8")), encoding="utf-8"
    )
    if subprocess.run([*pip, "install", *LOCKED, "-r", wanted], check=False).returncode:
        return False
    config = subprocess.run([*pip, "config", "list"], capture_output=True, text=True, check=False).stdout
    arguments, environment = as_uv_takes_it(told_to_pip(config), dict(os.environ))
    uv = [sys.executable, "-m", "uv", "pip", "install", "--no-config", "--python", sys.executable]
    return not subprocess.run([*uv, *arguments, "-r", packages], env=environment, check=False).returncode


def main(packages: Path) -> int:
    """Install the packages; return the status of what installed them."""
    if by_uv(packages):
        return 0
    print("uv is not there or did not succeed; pip installs the packages (some minutes).", file=sys.stderr)
    pip = [sys.executable, "-m", "pip", "install", "--no-compile"]
    return subprocess.run([*pip, *LOCKED, "-r", packages], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
