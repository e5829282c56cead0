"""Settings against what the papers print and the authors released, and what readings with these settings show.

Released code, read and not copied: Baaij et al., ``promasens``, commit 7f818d3.
"""

import pytest

from edition1.sensing.magnetic import EARTH_MT
from edition1_companion.twins.table_1_rows import ROWS, rows_named, simulate

BY_NAME = {row.name: row for row in ROWS}


class TestBaaij:
    @pytest.mark.parametrize(
        ("name", "ranges"),
        # of the readings along T3 [mT], which the released code's own data have
        [
            ("n_b=1", [0.92345]),
            ("n_b=2", [0.16533, 0.96032]),
            ("n_b=3", [0.92824, 0.92514, 1.02826]),
            ("n_e=(1,0,0)", [0.92562, 0.97282, 1.02896]),
        ],
    )
    def test_readings_have_the_ranges_of_the_released_data(self, name, ranges):
        """For each segment the range over its sensors together, or that of one of them: the digits are those."""
        u = simulate(rows_named([name])).u[:, 0]
        by_segment = u.unflatten(-1, (len(ranges), -1))
        span = by_segment.amax((0, 2)) - by_segment.amin((0, 2))
        assert span.tolist() == pytest.approx(ranges, abs=2e-4)

    def test_earth_field(self):
        assert float(BY_NAME["n_e=(0,1,0)"].earth_mt()[1]) == EARTH_MT == 0.065
