"""Denoises an image with Intel Open Image Denoise, from the extra `denoise`; imported only for the layer `denoised`."""

from importlib.metadata import version

import numpy as np

from isonoise.errors import UserError


def check_denoiser() -> None:
    """Raise UserError unless Open Image Denoise is installed and can be loaded."""
    try:
        import pyoidn  # noqa: F401
    except (ImportError, OSError) as error:
        raise UserError(
            f"the layer 'denoised' needs Open Image Denoise: pip install 'isonoise[denoise]' ({error})"
        ) from error


def denoiser_name() -> str:
    """Name and version of the denoiser, for the header of an image."""
    return f"Open Image Denoise {'.'.join(version('pyoidn').split('.')[:3])}"


def denoise(rgb: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Denoise an image as its documentation recommends for final frames.

    Albedo and normal are denoised first, each alone, and then count as free of noise ("prefiltering").
    https://www.openimagedenoise.org/documentation.html

    Parameters
    ----------
    rgb : (height, width, 3)
        Linear RGB of any scale.
    albedo, normal : (height, width, 3)
        The layers of these names.

    Returns
    -------
    (height, width, 3) float32

    Raises
    ------
    UserError
        If the denoiser fails.
    """
    import pyoidn

    color, albedo, normal = (np.ascontiguousarray(image, np.float32) for image in (rgb, albedo, normal))
    try:
        albedo, normal = _filtered("albedo", albedo), _filtered("normal", normal)
        return np.asarray(pyoidn.denoise(color, albedo=albedo, normal=normal, hdr=True, clean_aux=True))
    except (RuntimeError, OSError) as error:
        raise UserError(f"Open Image Denoise has failed: {error}") from error


def _filtered(name: str, image: np.ndarray) -> np.ndarray:
    """The layer, denoised alone. `pyoidn.denoise` always has a colour, so the filter is set up here."""
    import pyoidn

    result = np.zeros_like(image)
    with pyoidn.Device() as device:
        device.commit()
        with pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT) as filter_:
            filter_.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
            filter_.set_image(pyoidn.OIDN_IMAGE_OUTPUT, result, pyoidn.OIDN_FORMAT_FLOAT3)
            filter_.commit()
            filter_.execute()
        if error := device.get_error():
            raise RuntimeError(error)
    return result
