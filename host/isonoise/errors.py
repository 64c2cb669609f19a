"""Errors that are the user's to mend: the command line prints them without a traceback and exits with 2."""


class UserError(Exception):
    """Something in the user's input is wrong; the message says what, where, and what to do about it."""


class SceneError(UserError):
    """A scene file or dict is wrong or outside the supported subset; the message names file, element and remedy."""


class DeviceError(UserError):
    """No usable OpenCL device, or it cannot hold what the render needs; the message says what to install or change."""
