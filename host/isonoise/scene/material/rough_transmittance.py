"""Reflectance and transmittance of plastic's dielectric boundary, smooth and rough. Called by `bsdfs.py`.

The values are Mitsuba 3's, including its approximations, so that a material has the same colour in both.
"""

from functools import lru_cache

import numpy as np

NODES = 64
"""Number of cosines 0, 1/63 ... 1 at which a transmittance is tabulated; kernels interpolate linearly, like Mitsuba."""
# Nodes of quadrature along either axis. More are needed for total internal reflection.
_NODES_FROM_OUTSIDE, _NODES_FROM_INSIDE = 32, 128


def inner_reflectance(eta: float) -> float:
    """Mean reflectance of a smooth boundary for diffuse light from inside; `eta` is inner over outer index.

    Fits for eta > 1 (Egan and Hilgeman 1973, error up to 0.6 % below 2) and eta <= 1 (d'Eon and Irving 2011, 0.2 %).
    Above 3 it is computed by quadrature: there the fit, and so Mitsuba 3, creates energy, and from 3.9 on its
    transmittance is negative.
    """
    if eta > 3.0:
        cosines = (np.arange(4096) + 0.5) / 4096
        return float(2.0 * (_fresnel(cosines, 1.0 / eta)[0] * cosines).mean())
    if eta > 1.0:
        return -1.4399 / eta**2 + 0.7099 / eta + 0.6681 + 0.0636 * eta
    return float(np.polyval([-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317], eta))


@lru_cache(maxsize=64)
def rough_boundary(alpha: float, eta: float, ggx: bool) -> tuple[np.ndarray, float]:
    """(transmittance from outside (NODES,) float64, mean reflectance from inside) of an isotropic rough boundary.

    Only single scattering by the microfacets is included. The mean is Mitsuba's sum over the nodes, which gives both
    end nodes full weight.
    """
    cosines = np.maximum(np.linspace(0.0, 1.0, NODES), 1e-6)
    alpha = max(alpha, 1e-4)
    wi = np.stack([np.sqrt(1.0 - cosines**2), np.zeros(NODES), cosines])[:, :, None]
    transmittance = _scattered_fraction(wi, alpha, eta, ggx, is_transmitted=True)
    reflectance = _scattered_fraction(wi, alpha, 1.0 / eta, ggx, is_transmitted=False)
    return transmittance, float(2.0 * (reflectance * cosines).mean())


def _scattered_fraction(wi: np.ndarray, alpha: float, eta: float, ggx: bool, is_transmitted: bool) -> np.ndarray:
    """Fraction (n,) of the light from `wi` (3, n, 1) that is reflected or transmitted."""
    m, weight = _visible_normals(wi, alpha, ggx, _NODES_FROM_OUTSIDE if eta > 1.0 else _NODES_FROM_INSIDE)
    cosine = (wi * m).sum(axis=0)
    reflectance, cosine_refracted = _fresnel(cosine, eta)
    if is_transmitted:
        wo, fraction = (cosine / eta - cosine_refracted) * m - wi / eta, 1.0 - reflectance
    else:
        wo, fraction = 2.0 * cosine * m - wi, reflectance
    is_valid = (wo[2] < 0.0) if is_transmitted else (wo[2] > 0.0)
    return (fraction * np.where(is_valid, _smith_g1(wo, alpha, ggx), 0.0)) @ weight


def _fresnel(cosine: np.ndarray, eta: float) -> tuple[np.ndarray, np.ndarray]:
    """(reflectance, cosine of refraction) of a smooth boundary; `eta` is the far over the near index."""
    refracted = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
    parallel = (eta * cosine - refracted) / (eta * cosine + refracted)
    perpendicular = (cosine - eta * refracted) / (cosine + eta * refracted)
    return 0.5 * (parallel**2 + perpendicular**2), refracted


def _smith_g1(v: np.ndarray, alpha: float, ggx: bool) -> np.ndarray:
    """Smith's G1, as in kernels/bsdf/microfacet.h."""
    slope, z = alpha * np.hypot(v[0], v[1]), np.abs(v[2])
    if ggx:
        return 2.0 * z / (z + np.hypot(z, slope))
    fit = z * (3.535 * slope + 2.181 * z) / np.maximum(slope**2 + 2.276 * slope * z + 2.577 * z**2, 1e-300)
    return np.where(z >= 1.6 * slope, 1.0, fit)


def _visible_normals(wi: np.ndarray, alpha: float, ggx: bool, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Microfacet normals (3, n, k) visible from wi (3, n, 1) in the xz plane, and weights (k,) that sum to 1.

    They are the sampling routine's normals for the nodes of a Gauss-Legendre rule on the square, Mitsuba's quadrature.
    By symmetry, one half of the square is enough.
    """
    length = np.hypot(alpha * wi[0], wi[2])
    sine, cosine = alpha * wi[0] / length, wi[2] / length  # of wi, after stretching to roughness 1
    u, weight = np.polynomial.legendre.leggauss(nodes)
    weight = np.outer(weight, weight[nodes // 2 :]).ravel() / 2.0
    if ggx:
        x, y = _square_to_disk(u[None, nodes // 2 :], u[:, None])
        fraction = 0.5 * (1.0 + cosine)
        y = (1.0 - fraction) * np.sqrt(1.0 - x**2) + fraction * y
        z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
        stretched = [alpha * (z * sine - y * cosine), alpha * x, np.maximum(z * cosine + y * sine, 0.0)]
    else:
        x = np.stack([_beckmann_slopes(s, c, u) for s, c in zip(sine.ravel(), cosine.ravel(), strict=True)])
        y = _beckmann_slopes(0.0, 1.0, u[nodes // 2 :])
        stretched = [-alpha * np.repeat(x, len(y), axis=1), -alpha * np.tile(y, nodes), np.ones(1)]
    m = np.stack(np.broadcast_arrays(*stretched))
    return m / np.sqrt((m**2).sum(axis=0)), weight


def _square_to_disk(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shirley and Chiu's map of the square [-1, 1]^2 to the disk, flattened."""
    is_wide = np.abs(x) > np.abs(y)
    radius = np.where(is_wide, x, y)
    angle = np.pi / 4.0 * np.where(is_wide, y, x) / radius
    major, minor = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    return np.where(is_wide.ravel(), major, minor), np.where(is_wide.ravel(), minor, major)


def _beckmann_slopes(sine: float, cosine: float, u: np.ndarray) -> np.ndarray:
    """Visible slopes of a Gaussian surface of roughness 1, at the quantiles (1 + u) / 2.

    Heitz and d'Eon 2014: the density is exp(-x^2) (cosine - x sine) where that is positive. It is inverted by a table.
    """
    max_slope = 6.0  # the rest is below 1e-15
    x = np.linspace(-max_slope, cosine / sine if cosine < max_slope * sine else max_slope, 2001)
    density = np.exp(-(x**2)) * (cosine - x * sine)
    cdf = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return np.interp(0.5 * (1.0 + u), cdf / cdf[-1], x)
