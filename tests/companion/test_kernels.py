"""Kernels are compiled before pages and tests start."""

import pytest

from repro_companion import kernels


@pytest.mark.parametrize("name", kernels.PARTS)
def test_each_part_runs_without_a_warning(name):
    kernels.PARTS[name]()


def test_a_part_that_fails_is_told(monkeypatch, capfd):
    monkeypatch.setattr(kernels, "PARTS", {"nothing": None})
    assert kernels.main([]) == 0
    assert "each process compiles its own" in capfd.readouterr().err


def test_a_part_that_is_compiled_is_left_alone():
    note = kernels.note_of("filters")
    note.unlink(missing_ok=True)

    def noted() -> int:
        assert kernels.main([]) == 0
        return note.stat().st_mtime_ns

    assert noted() == noted()
