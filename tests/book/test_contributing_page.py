"""The examples of the page for contributors do what it says of them."""

from __future__ import annotations

import re
import warnings
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from library import test_estimators as suite

import repro
from repro.estimators import base
from repro.estimators.base import Estimator

PAGE = Path(__file__).resolve().parents[2] / "book" / "contributing.md"


@pytest.fixture(scope="module")
def there(tmp_path_factory) -> dict:
    """Return the names that the examples make."""
    found: dict = {}
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setenv("REPRO_RESULTS", str(tmp_path_factory.mktemp("results")))
        warnings.simplefilter("ignore", np.exceptions.ComplexWarning)  # a robot's poses are real
        exec(
            "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)), found
        )
    return found


def test_strings_have_their_closed_form_and_find_the_shape(there):
    theta, gaps = 0.7, 5
    q = np.array([[0.022 * theta, 0.0, 0.0], [0.0, 0.0, 0.0]])
    azimuths = np.array([0, 2 * np.pi / 3, 4 * np.pi / 3])
    radii = 0.11 / theta - 0.018 * np.cos(azimuths)
    expected = [2 * gaps * radii * np.sin(theta / gaps / 2), np.full(3, 0.11)]
    np.testing.assert_allclose(there["string_lengths"](q), expected)
    np.testing.assert_allclose(there["shape"].q, there["truth"], atol=1e-8)


def test_the_estimator_is_one_and_lags_less_than_its_low_pass(there):
    """Its prediction by speed brings it closer to a smooth motion; its state is never changed."""
    readings, truth = there["string_lengths"](there["truth"]), there["truth"]
    errors = {}
    for beta in (0.0, 0.2):
        method = there["AlphaBeta"](there["fit"], beta=beta)
        assert isinstance(method, Estimator)
        errors[beta] = np.abs(repro.track(method, readings, truth[0], rate_hz=100).q - truth)[50:].max()
    assert errors[0.2] < 0.5 * errors[0.0]
    state = method.init(truth[0])
    first = [method.step(state, readings[k], 0.01)[1].q for k in (1, 50, 1)]
    np.testing.assert_array_equal(first[0], first[2])


LAWS = [
    law
    for name, law in vars(suite).items()
    if name.startswith("test_") and "case" in signature(law).parameters
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_estimator_passes_the_suite_that_the_page_names(there, law):
    method = there["AlphaBeta"](repro.LevenbergMarquardt(suite.SENSING, suite.LOW, suite.HIGH, 1e-3))
    case = "alpha-beta", method, suite.Q0, suite.SENSING(suite.Q0 + 2e-4)
    law(case, *["nan"] * ("how" in signature(law).parameters))


def test_the_help_for_estimators_that_the_page_names_is_there():
    named = re.search(r"`repro.estimators.base`: (.*?)\. An", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert named is not None
    assert [name for name in re.findall(r"`(\w+)`", named[1]) if not hasattr(base, name)] == []


def test_the_paper_with_one_number_is_reproduced(there):
    """Half a unit of the last printed digit is the tolerance."""
    assert there["card"][["row", "verdict"]].to_numpy().tolist() == [["slow", "reproduced"]]
