"""What the tests bring along that is not ours."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

VENDOR = Path(__file__).resolve().parents[1] / "vendor"


def test_vendored_files_are_the_ones_named():
    """Each file has a source, a licence whose text lies beside it, and the hash it was taken with."""
    manifest = json.loads((VENDOR / "manifest.json").read_text(encoding="utf-8"))
    files = {path.relative_to(VENDOR).as_posix() for path in VENDOR.rglob("*") if path.is_file()}
    assert files - {"manifest.json"} == set(manifest)
    for name, entry in manifest.items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == entry["sha256"], name
        assert "axe-core 4.14.1" in entry["from"]
        assert entry["licence"] == "MPL-2.0"
    assert "Mozilla Public License" in (VENDOR / "axe-core" / "LICENSE").read_text(encoding="utf-8")
