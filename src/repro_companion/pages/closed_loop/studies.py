"""The studies of the page on the closed loop."""

from repro_companion.book.studies import Study
from repro_companion.pages.closed_loop.estimators import changed_errors, estimator_errors, twin_errors
from repro_companion.pages.closed_loop.tables import cause_errors, loop_errors

SETTINGS = {"seeds": list(range(12)), "duration_s": 25.0}
STUDIES = (
    Study("closed_loop", loop_errors, SETTINGS),
    Study("loop_causes", cause_errors, SETTINGS),
    Study("loop_estimators", estimator_errors, SETTINGS),
    Study("loop_changed", changed_errors, {"seeds": [0, 1, 2, 3], "duration_s": 25.0}),
    Study("loop_twins", twin_errors, {"twins": [2, 3, 4, 7], "seeds": [0, 1], "duration_s": 25.0}),
)
