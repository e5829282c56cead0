"""The study of the page on Table 1: its training with one factor changed at a time."""

from edition1_companion.book.studies import Study
from edition1_companion.pages.table_1.training import NEW_ORDER, OTHER_DRAWS, factor_errors

ROBOTS = {NEW_ORDER: [1, 2, 3], OTHER_DRAWS: [2]}
"""Numbers of segments by factor: other draws for two segments alone, whose errors lie furthest from print."""
STUDIES = (
    Study("table_1_factors", factor_errors, {"robots": ROBOTS, "seeds": [0, 1, 2]}, ("cache", "progress")),
)
