"""Settings against what the papers print and the authors released, and what readings with these settings show.

Released code, read and not copied: Baaij et al., ``promasens``, commit 7f818d3; Mitchell et al., branch
``parallel-chain``, commit 382a4ae. Where paper and code differ, the line says which of them it is.
"""

import math
from dataclasses import replace

import pandas as pd
import pytest
import torch

from edition1.estimation.base import Trajectory
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import EARTH_MT
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.pages.probabilistic_curvature import simulation
from edition1_companion.pages.table_1.scorecard import scorecard_rows
from edition1_companion.twins import rig_descent as table2
from edition1_companion.twins import table_1_method as table1
from edition1_companion.twins.bend_filters import PAPER_SETTINGS
from edition1_companion.twins.table_1_rows import ROWS, rows_named, simulate

BY_NAME = {row.name: row for row in ROWS}


class TestBaaij:
    @pytest.mark.parametrize(
        ("n_segments", "bending", "elongation"),
        [
            (1, 3.5e-4, 3.5e-4),
            (2, 3e-3, 3e-4),
            (3, 2e-3, 2e-4),
        ],  # section 3.3, and the same in the released code
    )
    def test_step_sizes_of_table_1(self, n_segments, bending, elongation):
        expected = torch.tensor([bending, bending, elongation] * n_segments, dtype=torch.float64)
        assert torch.equal(table1.step_sizes(n_segments), expected)
        given = table1.step_sizes(n_segments, 1.0, 2.0)
        assert given.tolist() == [1.0, 1.0, 2.0] * n_segments

    def test_descent_of_both_tables(self):
        """Momentum 0.3 and 0.2; 20 evaluations; 1.5e-8 for the bending of the rig, whose elongation is known."""
        assert (table1.MOMENTUM, table1.ITERATIONS) == (0.3, 20)
        assert (table2.MOMENTUM, table2.ITERATIONS) == (0.2, 20)
        assert table2.STEP_SIZE == (1.5e-8, 1.5e-8, 0.0)

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

    def test_relative_and_absolute_errors_of_a_made_up_estimate(self):
        """Eq. (13) by hand: errors of 3 and 4 in turn have a root mean square of sqrt(12.5), a mean of 3.5."""
        rows = rows_named(["n_b=1"])
        made = simulate(rows, steps=4)
        q = torch.tensor([[0.0, 0.0, 0.0], [10.0, 20.0, 5.0], [0.0, 0.0, 0.0], [10.0, 20.0, 5.0]]).double()
        off = torch.tensor([3.0, -4.0, -3.0, 4.0], dtype=torch.float64)[:, None].expand(4, 3)
        found = Trajectory((q + off)[:, None, None], None, made.u[:, None], {})
        # prediction errors: 1 and 7 at sensor 1 (root mean square 5), 2 at sensor 2, none at sensor 3
        wrong = torch.tensor([[1.0, 2.0, 0.0], [7.0, -2.0, 0.0]] * 2, dtype=torch.float64)
        predicted = (made.u + wrong[:, None])[None]
        table = table1.errors_of_estimates(replace(made, q=q), found, predicted, (7,)).set_index("quantity")[
            "error"
        ]
        assert table["e_u"] == pytest.approx((5 + 2 + 0) / 3)
        for name, span in (("delta_x_1", 10.0), ("delta_y_1", 20.0), ("delta_L_1", 5.0)):
            assert table[name] == pytest.approx(100 * math.sqrt(12.5) / span)

    def test_claim_of_section_3_5_is_the_mean_of_the_tilted_and_the_shifted_sensors(self):
        """Tilted 2 %, shifted 4 %, all other rows 100 %: 3 %, and readings in mT do not count. Likewise for the best.

        "Tilted and shifted": the rows psi_s = 10 degrees and d_s,r = 16 mm, whose printed cells have a mean of 4.2.
        """
        sizes = {"psi_s=10deg": 2.0, "d_s_r=16mm": 4.0}
        cells = [
            {"row": row.name, "quantity": name, "unit": unit, "error_percent": sizes.get(row.name, 100.0)}
            for row in ROWS
            for name, unit in [("e_u", "mT"), *((c, "%") for c in row.robot().coordinates)]
        ]
        errors = [c | {"seed": seed, "error": c["error_percent"] + seed} for c in cells for seed in (-1, 1)]
        for cell in errors:
            cell["error"] = 50.0 if cell["unit"] == "mT" else cell["error"]
        best = pd.DataFrame([c for c in cells if c["unit"] == "%"])
        lines = scorecard_rows(pd.DataFrame(errors), best)
        (line,) = [line for line in lines if line["artefact"] == "Section 3.5"]
        assert line["regenerated"] == pytest.approx(3.0)
        assert line["regenerated_std"] == pytest.approx(math.sqrt(2))  # of 2 and 4, one number for each seed
        assert line["best"] == pytest.approx(3.0)
        printed = [
            float(row.value)
            for key, row in read_published(find_project().published).items()
            if key.artefact == "Table 1" and key.row in sizes and key.unit == "%"
        ]
        assert len(printed) == 18
        assert sum(printed) / 18 == pytest.approx(4.2, abs=0.05)


class TestMitchell:
    def test_process_noise_of_the_bend_tests(self):
        """Printed: 0.002 pi. Released: s pi/2 with s = 0.001, on the transverse field alone, zeroed at rest."""
        printed, released = (PAPER_SETTINGS[f"paper, as {name}"] for name in ("printed", "released"))
        assert printed["process_noise_pi"] == 0.002
        assert released["process_noise_pi"] == pytest.approx(0.001 / 2)
        assert [x["axial"] for x in (printed, released)] == [True, False]
        assert [x["zeroed"] for x in (printed, released)] == [False, True]

    def test_settings_of_the_simulation(self):
        """Printed: 0.02 pi, 15 mm. The released code's simulations: s pi/2 with s = 0.01, 14 mm, sigma 0.01 mT."""
        paper, fits = simulation.PAPER, simulation.FITS
        assert (paper.process_noise_pi, paper.length_m, paper.particles) == (0.02, 15e-3, 1000)
        assert (fits.process_noise_pi, fits.length_m) == (pytest.approx(0.01 / 2), 14e-3)
        assert paper.sigma_mt == fits.sigma_mt == 0.01
        assert paper.sensor_noise_mt == fits.sensor_noise_mt == 0.0

    @pytest.mark.parametrize("setting", [simulation.BEST, simulation.NOISY], ids=["best", "noisy"])
    def test_noise_is_that_of_the_real_sensor(self, setting):
        """0.021 to 0.026 mT on each axis at rest; eq. (1) has no factor 1/2, so its sigma is sqrt(2) times that."""
        assert 0.021 <= setting.sensor_noise_mt <= 0.026
        assert setting.sigma_mt == pytest.approx(math.sqrt(2) * setting.sensor_noise_mt)

    def test_readings_that_the_best_filter_follows_have_that_noise(self):
        """Least squares on each reading shows the noise: nearly straight, 1 rad moves the magnet by L/2 = 7.5 mm and
        the transverse field by 4.06 mT, so two axes of noise sigma make sigma 7.5/4.06 sqrt(2) mm.

        One Gauss-Newton step from the cloud's mean is least squares, as the field is nearly linear.
        """
        setting = replace(simulation.BEST, estimate="Gauss-Newton", motion="random walk", particles=200)
        error, lost = simulation.follow(setting, steps=300, curves=["spiral"])
        J = torch.func.jacrev(BendSensor(15e-3))(torch.full((2,), 1e-6, dtype=torch.float64))
        assert float(torch.linalg.svdvals(J[..., :])[0]) == pytest.approx(4.06, abs=0.01)
        rms = float(error.square().mean().sqrt())
        assert rms == pytest.approx(0.025 * 7.5 / 4.06 * math.sqrt(2), rel=0.1)
        assert not lost.any()
