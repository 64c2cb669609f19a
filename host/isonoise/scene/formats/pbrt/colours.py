"""Turns pbrt's spectra into linear RGB: rgb, blackbody, sampled spectra, named spectra and files.

pbrt-v4 (`SpectrumToPhotometric`) divides the spectrum of a light by its luminance: only `scale`, `power` and
`illuminance` set how bright it is. Its rgb values are multiples of the colour space's white.
"""

from pathlib import Path

import numpy as np

from isonoise.errors import SceneError
from isonoise.scene.files import read_bytes
from isonoise.scene.formats.pbrt.directives import find_file
from isonoise.scene.formats.pbrt.parameters import Value
from isonoise.scene.formats.report import ImportReport
from isonoise.scene.material.presets import conductors
from isonoise.scene.parse.elements import path_exists
from isonoise.scene.spectra import MITSUBA_LUMINANCE, spectrum_to_rgb, xyz_to_rgb

_GLASSES = {  # refractive index at 587.6 nm (Schott); pbrt's names F5, F10, F11 are SF5, SF10, SF11
    "glass-BK7": 1.5168,
    "glass-BAF10": 1.67003,
    "glass-FK51A": 1.48656,
    "glass-LASF9": 1.85025,
    "glass-F5": 1.6727,
    "glass-F10": 1.72825,
    "glass-F11": 1.78472,
}
_BRASS = (np.array([0.444, 0.527, 1.094]), np.array([3.695, 2.765, 1.829]))  # eta, k of CuZn, which Mitsuba lacks
_METALS = ("Ag", "Al", "Au", "Cu", "CuZn", "MgO", "TiO2")
_ILLUMINANTS = {  # CIE 1931 chromaticity x, y (CIE 15:2004); of illum-acesD60: SMPTE ST 2065-1
    "stdillum-A": (0.44758, 0.40745),
    "stdillum-D50": (0.34567, 0.35850),
    "stdillum-D65": (0.31272, 0.32903),
    "stdillum-F1": (0.3131, 0.3371),
    "stdillum-F2": (0.3721, 0.3751),
    "stdillum-F3": (0.4091, 0.3941),
    "stdillum-F4": (0.4402, 0.4031),
    "stdillum-F5": (0.3138, 0.3452),
    "stdillum-F6": (0.3779, 0.3882),
    "stdillum-F7": (0.3129, 0.3292),
    "stdillum-F8": (0.3458, 0.3586),
    "stdillum-F9": (0.3741, 0.3727),
    "stdillum-F10": (0.3458, 0.3588),
    "stdillum-F11": (0.3805, 0.3769),
    "stdillum-F12": (0.4370, 0.4042),
    "illum-acesD60": (0.32168, 0.33767),
}
_NAMED = (*_GLASSES, *_ILLUMINANTS, *(f"metal-{metal}-{part}" for metal in _METALS for part in ("eta", "k")))
_TO_SRGB = {  # linear RGB of a colour space with the white D65 -> linear sRGB (ITU-R BT.2020, SMPTE EG 432-1)
    "rec2020": np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]),
    "dci-p3": np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]),
}
COLOUR_SPACES = ("srgb", "rec2020", "dci-p3", "aces2065-1")
_SECOND_RADIATION_CONSTANT = 1.438777e7  # hc / k, nm K
_MIN_KELVIN, _MAX_KELVIN = 100.0, 1e6
_MAX_SPECTRUM_NUMBERS = 1 << 20
_ROUNDING = 1e-3  # of reflectances: white of another colour space is not exactly 1


class Colours:
    """Reads the spectra of one scene. `base` and `folder` are those of `find_file`."""

    def __init__(self, base: Path, folder: Path | None, report: ImportReport):
        self._base, self._folder, self._report = base, folder, report
        self.colour_space = "srgb"  # of rgb values; set by the directive ColorSpace

    def reflectance(self, value: Value) -> np.ndarray:
        """Linear RGB (3,) within [0, 1]."""
        rgb = self._rgb(value, "reflectance")
        if rgb.min() < -_ROUNDING or rgb.max() > 1 + _ROUNDING:
            self._report.limit(
                "spectra", "a reflectance outside 0 to 1 is clamped", f"{value.name} ({value.position.place})"
            )
        return np.clip(rgb, 0.0, 1.0)

    def unbounded(self, value: Value) -> np.ndarray:
        """Linear RGB (3,) of eta, k, or a coefficient of a medium; at least 0."""
        return np.maximum(self._rgb(value, "unbounded"), 0.0)

    def emission(self, value: Value) -> np.ndarray:
        """Linear RGB (3,) of a light; except for rgb, of luminance 1 as in pbrt-v4."""
        self._report.use("spectra")
        if value.type == "blackbody":
            return self._blackbody(value)
        if value.type in ("rgb", "color", "xyz"):
            rgb = np.maximum(self._rgb(value, "radiance"), 0.0)
        else:
            rgb = _scaled_to_luminance_1(self._rgb(value, "radiance"))
        if not rgb.any() and np.any(value.values if not value.is_texts else 1):
            self._report.limit("spectra", "a light without visible emission is black", value.position.place)
        return rgb

    def refractive_index(self, value: Value) -> float:
        """An index of refraction: a number, or a spectrum at the line d, without dispersion."""
        if value.type == "float":
            return float(value.values[0])
        if value.is_texts and value.values[0] in _GLASSES:
            self._report.use("dispersion", value.values[0])
            return _GLASSES[value.values[0]]
        if value.type == "spectrum":
            pairs = self._pairs(value)
            if np.ptp(pairs[:, 1]) > 0:
                self._report.use("dispersion", value.position.place)
            return float(np.interp(587.6, pairs[:, 0], pairs[:, 1]))
        return float(self._rgb(value, "unbounded").mean())

    def _rgb(self, value: Value, kind: str) -> np.ndarray:
        if value.type in ("rgb", "color"):
            return self._from_colour_space(value.values[:3])
        if value.type == "xyz":
            return xyz_to_rgb(value.values[:3])
        if value.type in ("float", "integer"):
            return np.full(3, value.values[0])
        if value.type == "blackbody":
            return self._blackbody(value)
        if value.is_texts and value.values[0] in _NAMED:
            return self._named(value.values[0])
        pairs = self._pairs(value)
        return spectrum_to_rgb(pairs[:, 0], pairs[:, 1], kind)

    def _from_colour_space(self, rgb: np.ndarray) -> np.ndarray:
        if self.colour_space == "aces2065-1":
            self._report.limit("spectra", "colours of the space aces2065-1 are read as sRGB")
        return _TO_SRGB[self.colour_space] @ rgb if self.colour_space in _TO_SRGB else np.array(rgb)

    def _named(self, name: str) -> np.ndarray:
        if name in _GLASSES:
            return np.full(3, _GLASSES[name])
        if name in _ILLUMINANTS:
            x, y = _ILLUMINANTS[name]
            return np.maximum(xyz_to_rgb([x / y, 1.0, (1 - x - y) / y]), 0.0)
        _, metal, part = name.split("-")
        eta_and_k = conductors().get(metal, _BRASS)
        return eta_and_k[0 if part == "eta" else 1]

    def _blackbody(self, value: Value) -> np.ndarray:
        """Luminance 1, times pbrt-v3's factor if there is one."""
        kelvin = float(value.values[0])
        if not _MIN_KELVIN <= kelvin <= _MAX_KELVIN:
            value.position.raise_error(f"'{value.name}' has to be {_MIN_KELVIN:g} to {_MAX_KELVIN:g} kelvin")
        wavelengths = np.arange(360.0, 831.0)
        with np.errstate(over="ignore"):
            radiance = 1.0 / (wavelengths**5 * np.expm1(_SECOND_RADIATION_CONSTANT / (wavelengths * kelvin)))
        rgb = _scaled_to_luminance_1(spectrum_to_rgb(wavelengths, radiance / radiance.max(), "radiance"))
        return rgb * float(value.values[1]) if len(value.values) == 2 else rgb

    def _pairs(self, value: Value) -> np.ndarray:
        """Wavelengths in nm and values (n, 2) of a sampled spectrum or a file."""
        numbers = self._file_numbers(value) if value.is_texts else value.values
        if len(numbers) < 2 or len(numbers) % 2:
            value.position.raise_error(f"'{value.name}' needs pairs of wavelength and value")
        pairs = numbers.reshape(-1, 2)
        if (np.diff(pairs[:, 0]) <= 0).any():
            value.position.raise_error(f"the wavelengths of '{value.name}' have to increase")
        return pairs if len(pairs) > 1 else np.stack([pairs[0], pairs[0] + (1.0, 0.0)])

    def _file_numbers(self, value: Value) -> np.ndarray:
        name = value.values[0]
        if not (name.endswith(".spd") or "/" in name or path_exists(self._base / name)):
            value.position.raise_unknown("unknown spectrum", name, _NAMED)
        path = find_file(name, self._base, self._folder, value.position)
        lines = read_bytes(path).decode("utf-8", errors="replace").splitlines()
        words = " ".join(line.partition("#")[0] for line in lines).split()
        try:
            numbers = np.array(words[:_MAX_SPECTRUM_NUMBERS], np.float64)
        except ValueError:
            raise SceneError(f"{path}: a spectrum is pairs of numbers: wavelength in nm and value") from None
        if not np.isfinite(numbers).all():
            raise SceneError(f"{path}: a number is not finite")
        return numbers


def _scaled_to_luminance_1(rgb: np.ndarray) -> np.ndarray:
    luminance = float(MITSUBA_LUMINANCE @ rgb)
    return rgb / luminance if luminance > 0 else np.zeros(3)
