r"""The multipole field of an axisymmetric magnet, compiled: reading and slopes for one sensor and one magnet.

.. math:: u = f \cos\alpha + g \cos\beta, \qquad f = -\sum_l \frac{A_l P'_l(c)}{d^{l+2}}, \quad
          g = \sum_l \frac{A_l P'_{l+1}(c)}{d^{l+2}}, \quad c = \cos\theta

over odd ``l``, as in :mod:`edition1.sensing.multipole`; Legendre polynomials and their derivatives by recurrence.
"""

from __future__ import annotations

from edition1.kernels.compilation import machine_code

ORDERS = 32
"""Largest number of moments."""
_BY_C = tuple((2.0 * n + 1.0) / (n + 1.0) for n in range(2 * ORDERS + 2))
_BACK = tuple(n / (n + 1.0) for n in range(2 * ORDERS + 2))


@machine_code(reorder=True)
def multipole(moments, d, cos_alpha, cos_beta, c):
    r"""Reading of one sensor in the field of one magnet, and its slopes.

    Parameters
    ----------
    moments
        :math:`A_1, A_3, ...` [mT m^(l+2)], an array.
    d, cos_alpha, cos_beta, c
        Relations of eq. (1) as cosines; ``c`` is :math:`\cos\theta`.

    Returns
    -------
    tuple
        Reading [mT]; slopes by ``d`` [mT/m], by the cosines of alpha, beta and theta [mT].
    """
    inverse = 1.0 / d
    squared = inverse * inverse
    decay = squared * inverse
    f, g, f_c, g_c, u_d = 0.0, 0.0, 0.0, 0.0, 0.0
    p_0, p_1 = 1.0, c  # P_(l-1), P_l
    s_0, s_1 = 0.0, 1.0  # first derivatives
    t_0, t_1 = 0.0, 0.0  # second derivatives
    for k in range(len(moments)):
        n = 2 * k + 1
        p_2, s_2, t_2 = (
            _BY_C[n] * c * p_1 - _BACK[n] * p_0,
            s_0 + (2 * n + 1) * p_1,
            t_0 + (2 * n + 1) * s_1,
        )
        weight = moments[k] * decay
        f -= weight * s_1
        g += weight * s_2
        f_c -= weight * t_1
        g_c += weight * t_2
        u_d += (n + 2) * weight * (s_1 * cos_alpha - s_2 * cos_beta)
        p_0, s_0, t_0 = p_2, s_2, t_2  # two orders on
        p_1, s_1, t_1 = (
            _BY_C[n + 1] * c * p_2 - _BACK[n + 1] * p_1,
            s_1 + (2 * n + 3) * p_2,
            t_1 + (2 * n + 3) * s_2,
        )
        decay *= squared
    return f * cos_alpha + g * cos_beta, u_d * inverse, f, g, f_c * cos_alpha + g_c * cos_beta
