"""The library refuses bad input in the one form, also where nothing checks shapes."""

import subprocess
import sys

from refusals import CASES


def test_bad_input_is_refused_in_the_one_form():
    assert len(CASES) > 30
    done = subprocess.run(
        [sys.executable, "tests/edition1/library/refusals.py"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.splitlines() == []
