"""The studies of the page on random twins: both methods on each family."""

from repro_companion.book.studies import Study
from repro_companion.pages.robustness.twins import FAMILIES, TWINS, robustness_errors

STUDIES = tuple(
    Study(
        f"robustness_{family.replace(' ', '_')}",
        robustness_errors,
        {"family": family, "twins": list(TWINS), "seed": 0, "longest_s": 60.0},
        ("cache", "progress"),
    )
    for family in FAMILIES
)
