"""What boundaries do to light that crosses them: mean inner reflectance, and transmittance by angle of rough ones.

Numbers are Mitsuba 3's, its approximations included: a material has the same colour in both.
"""

from functools import lru_cache

import numpy as np

NODES = 64
"""Cosines 0, 1/63 ... 1 at which a transmittance is tabulated; kernels interpolate linearly, as Mitsuba does."""
_FEW_NODES, _MANY_NODES = 32, 128  # of quadrature along either axis; many where there is total reflection


def inner_reflectance(eta: float) -> float:
    """Mean reflectance of a smooth boundary for diffuse light from within; `eta` is inner over outer index.

    Fits for eta > 1 (Egan and Hilgeman 1973, to 0.6 % below 2) and eta <= 1 (d'Eon and Irving 2011, 0.2 %). Above 3 the
    true one, by quadrature: the fit, and so Mitsuba 3, makes more light than comes in, and from 3.9 on less than none.
    """
    if eta > 3.0:
        cosines = (np.arange(4096) + 0.5) / 4096
        return float(2.0 * (_fresnel(cosines, 1.0 / eta)[0] * cosines).mean())
    if eta > 1.0:
        return -1.4399 / eta**2 + 0.7099 / eta + 0.6681 + 0.0636 * eta
    return float(np.polyval([-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317], eta))


@lru_cache(maxsize=64)
def rough_boundary(alpha: float, eta: float, ggx: bool) -> tuple[np.ndarray, float]:
    """(transmittance from outside (NODES,) float64, mean reflectance from within) of an isotropic rough boundary.

    Single scattering at its facets. The mean is the sum over the nodes by Mitsuba, which counts both ends in full.
    """
    cosines = np.maximum(np.linspace(0.0, 1.0, NODES), 1e-6)
    alpha = max(alpha, 1e-4)
    w = np.stack([np.sqrt(1.0 - cosines**2), np.zeros(NODES), cosines])[:, :, None]
    transmittance = _scattered(w, alpha, eta, ggx, transmitted=True)
    reflectance = _scattered(w, alpha, 1.0 / eta, ggx, transmitted=False)
    return transmittance, float(2.0 * (reflectance * cosines).mean())


def _scattered(w: np.ndarray, alpha: float, eta: float, ggx: bool, transmitted: bool) -> np.ndarray:
    """Share of the light from `w` (3, n, 1) that is reflected, or transmitted: (n,)."""
    m, weight = _facets(w, alpha, ggx, _FEW_NODES if eta > 1.0 else _MANY_NODES)
    cosine = (w * m).sum(axis=0)
    reflectance, refracted = _fresnel(cosine, eta)
    if transmitted:
        o, share = (cosine / eta - refracted) * m - w / eta, 1.0 - reflectance
    else:
        o, share = 2.0 * cosine * m - w, reflectance
    leaves = (o[2] < 0.0) if transmitted else (o[2] > 0.0)
    return (share * np.where(leaves, _seen(o, alpha, ggx), 0.0)) @ weight


def _fresnel(cosine: np.ndarray, eta: float) -> tuple[np.ndarray, np.ndarray]:
    """(reflectance, cosine of refraction) of a smooth boundary; `eta` is index of the far side over the near."""
    refracted = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
    parallel = (eta * cosine - refracted) / (eta * cosine + refracted)
    perpendicular = (cosine - eta * refracted) / (cosine + eta * refracted)
    return 0.5 * (parallel**2 + perpendicular**2), refracted


def _seen(v: np.ndarray, alpha: float, ggx: bool) -> np.ndarray:
    """Smith's G1, as in kernels/bsdf/microfacet.h."""
    slope, z = alpha * np.hypot(v[0], v[1]), np.abs(v[2])
    if ggx:
        return 2.0 * z / (z + np.hypot(z, slope))
    fit = z * (3.535 * slope + 2.181 * z) / np.maximum(slope**2 + 2.276 * slope * z + 2.577 * z**2, 1e-300)
    return np.where(z >= 1.6 * slope, 1.0, fit)


def _facets(w: np.ndarray, alpha: float, ggx: bool, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals (3, n, k) as they are seen from w (3, n, 1) in the xz plane, and weights (k,) of sum 1.

    They are what the sampling routine makes of the nodes of a Gauss-Legendre rule on the square: Mitsuba's quadrature.
    One half of the square stands for both.
    """
    length = np.hypot(alpha * w[0], w[2])
    sine, cosine = alpha * w[0] / length, w[2] / length  # as a surface of roughness 1 sees it
    at, weight = np.polynomial.legendre.leggauss(nodes)
    weight = np.outer(weight, weight[nodes // 2 :]).ravel() / 2.0
    if ggx:
        x, y = _disk(at[None, nodes // 2 :], at[:, None])
        share = 0.5 * (1.0 + cosine)
        y = (1.0 - share) * np.sqrt(1.0 - x**2) + share * y
        z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
        slopes = [alpha * (z * sine - y * cosine), alpha * x, np.maximum(z * cosine + y * sine, 0.0)]
    else:
        along = np.stack([_slopes(s, c, at) for s, c in zip(sine.ravel(), cosine.ravel(), strict=True)])
        across = _slopes(0.0, 1.0, at[nodes // 2 :])
        slopes = [-alpha * np.repeat(along, len(across), axis=1), -alpha * np.tile(across, nodes), np.ones(1)]
    m = np.stack(np.broadcast_arrays(*slopes))
    return m / np.sqrt((m**2).sum(axis=0)), weight


def _disk(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shirley and Chiu's map of the square [-1, 1]^2 to the disk, flattened."""
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    angle = np.pi / 4.0 * np.where(wide, y, x) / radius
    near, far = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    return np.where(wide.ravel(), near, far), np.where(wide.ravel(), far, near)


def _slopes(sine: float, cosine: float, at: np.ndarray) -> np.ndarray:
    """Slopes of a Gaussian surface of roughness 1 below which it shows (1 + at) / 2 of itself to the direction.

    Heitz and d'Eon 2014: the density is exp(-x^2) (cosine - x sine) where that is positive; here as a table.
    """
    farthest = 6.0  # the rest is below 1e-15
    x = np.linspace(-farthest, cosine / sine if cosine < farthest * sine else farthest, 2001)
    density = np.exp(-(x**2)) * (cosine - x * sine)
    below = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return np.interp(0.5 * (1.0 + at), below / below[-1], x)
