"""Settings against what the papers print and the authors released, and what readings with these settings show.

Released code, read and not copied: Baaij et al., ``promasens``, commit 7f818d3; Mitchell et al., branch
``parallel-chain``, commit 382a4ae. Where paper and code differ, the line says which of them it is.
"""

import math
from dataclasses import replace

import pytest
import torch

from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import EARTH_MT
from edition1_companion.pages.probabilistic_curvature import simulation
from edition1_companion.twins.bend_filters import PAPER_SETTINGS
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
